#include "counts.h"

#include "config.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdbool.h>

static volatile int8_t left_count;
static volatile int8_t right_count;

#if EDGES == 2
/* Half pulses. Each edge of A makes even odd and odd even, so the count's lowest bit is the level of A when last seen;
 * where A is as it was, the edge was of a spike too short to be read, and is no pulse. */
static inline __attribute__((always_inline)) void count(volatile int8_t *counter, uint8_t pins, uint8_t a, uint8_t b)
{
    int8_t halves = *counter;
    if (pins & _BV(a)) {
        if (halves & 1)
            return;
        halves += pins & _BV(b) ? -1 : 1;
    } else {
        if (!(halves & 1))
            return;
        halves += pins & _BV(b) ? 1 : -1;
    }
    *counter = halves;
}
#else
static inline __attribute__((always_inline)) void count(volatile int8_t *counter, uint8_t pins, uint8_t a, uint8_t b)
{
    (void)a;
    *counter += pins & _BV(b) ? -1 : 1;
}
#endif

ISR(INT0_vect)
{
    count(&left_count, PIND, LEFT_A, LEFT_B);
}

ISR(INT1_vect)
{
    count(&right_count, PIND, RIGHT_A, RIGHT_B);
}

/* Half pulses become pulses where A rises going forward, and the same place takes the pulse back going backward. */
static int8_t take(volatile int8_t *counter)
{
#if EDGES == 2
    const int8_t pulses = (*counter + 1) >> 1;
    *counter -= 2 * pulses;
#else
    const int8_t pulses = *counter;
    *counter = 0;
#endif
    return pulses;
}

void counts_take(int8_t *left, int8_t *right)
{
    *left = take(&left_count);
    *right = take(&right_count);
}

void counts_init(void)
{
    /* Pull-ups: an unplugged encoder is a wheel at rest. */
    PORTD |= _BV(LEFT_A) | _BV(RIGHT_A) | _BV(LEFT_B) | _BV(RIGHT_B);
#if EDGES == 2
    MCUCR |= _BV(ISC00) | _BV(ISC10);
    left_count = PIND & _BV(LEFT_A) ? -1 : 0;
    right_count = PIND & _BV(RIGHT_A) ? -1 : 0;
#else
    MCUCR |= _BV(ISC01) | _BV(ISC00) | _BV(ISC11) | _BV(ISC10);
#endif
    GIFR = _BV(INTF0) | _BV(INTF1);
    GICR |= _BV(INT0) | _BV(INT1);
}
