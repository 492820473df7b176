#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>

static volatile uint8_t overflows;

ISR(TIMER0_OVF_vect)
{
    overflows++;
}

uint16_t clock_ticks(void)
{
    uint8_t low = TCNT0;
    uint8_t high = overflows;
    /* An overflow that has happened but was not yet counted; read again, for it may have come after the first. */
    if (TIFR & _BV(TOV0)) {
        low = TCNT0;
        high++;
    }
    return (uint16_t)high << 8 | low;
}

/* A tick is 625/144 µs; what is left of a division waits for the next, so that the clock never drifts. */
uint32_t clock_us(uint16_t ticks)
{
    static uint32_t us;
    static uint16_t last_ticks;
    static uint8_t remainder;

    const uint32_t parts = (uint32_t)(uint16_t)(ticks - last_ticks) * 625 + remainder;
    last_ticks = ticks;
    us += parts / 144;
    remainder = parts % 144;
    return us;
}

void clock_init(void)
{
    TCCR0 = _BV(CS01) | _BV(CS00);
    TIMSK |= _BV(TOIE0);
}

_Static_assert(F_CPU / 64 / 144 * 625 == 1000000UL, "clock_us is written for ticks of 625/144 us");
