#include "nearby.h"

#include "registers.h"

/* Port D: echoes on 0 to 3, bumpers on 6 and 7, with pull-ups; the trigger on 8. A cut cable is a bumper that is pressed,
 * and a ranger that does not answer. */
#define BUMPER_0 6
#define TRIGGER 8

void nearby_init(void)
{
    for (unsigned pin = 0; pin < 8; pin++)
        if (pin < RANGERS || pin >= BUMPER_0)
            GPIOD->PUPDR |= 1UL << 2 * pin;
    GPIOD->MODER |= 1UL << 2 * TRIGGER;
}

uint8_t nearby_levels(void)
{
    const uint32_t pins = GPIOD->IDR;
    return (uint8_t)((pins & 0xF) | (pins >> BUMPER_0 & 3) << RANGERS);
}

void nearby_trigger(uint8_t level)
{
    GPIOD->BSRR = level ? BIT(TRIGGER) : BIT(TRIGGER + 16);
}
