/* From reset to main: the vector table, and memory as C expects it. */
#include <stdint.h>

extern uint32_t stack_top, data_begin, data_end, data_load, bss_begin, bss_end;

int main(void);
void reset(void);
void fault(void);

void reset(void)
{
    for (uint32_t *to = &data_begin, *from = &data_load; to < &data_end;)
        *to++ = *from++;
    for (uint32_t *to = &bss_begin; to < &bss_end;)
        *to++ = 0;
    main();
}

void fault(void)
{
    for (;;) /* until the watchdog bites */
        ;
}

/* No interrupt is ever enabled, so that the table ends with the system's own. */
__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
};
