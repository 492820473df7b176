#include "nearby.h"

#include "config.h"

#include <avr/io.h>

/* Pull-ups: a cut cable is a bumper that is pressed, and a ranger that does not answer. */
void nearby_init(void)
{
    PORTC |= _BV(ECHO_0) | _BV(ECHO_1) | _BV(BUMPER_0) | _BV(BUMPER_1);
    PORTD |= _BV(ECHO_2) | _BV(ECHO_3);
    DDRB |= _BV(TRIGGER);
}

uint8_t nearby_levels(void)
{
    const uint8_t c = PINC, d = PIND;
    return (c >> ECHO_0 & 1) | (c >> ECHO_1 & 1) << 1 | (d >> ECHO_2 & 1) << 2 | (d >> ECHO_3 & 1) << 3 |
           (c >> BUMPER_0 & 1) << 4 | (c >> BUMPER_1 & 1) << 5;
}

void nearby_trigger(uint8_t level)
{
    if (level)
        PORTB |= _BV(TRIGGER);
    else
        PORTB &= ~_BV(TRIGGER);
}
