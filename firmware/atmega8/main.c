/* Wheel controller: counts two encoders and drives two motors, at the word of a host on the serial line.
 * After Trinh et al., section II.C: external interrupts count, Timer0 times the frames, Timer1 makes the PWM,
 * and commands come last. */
#include "clock.h"
#include "config.h"
#include "counts.h"
#include "nearby.h"
#include "protocol.h"
#include "pwm.h"
#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>

static struct sample sample;
static struct frame_reader reader;

static void look(void)
{
    int8_t left, right;
    ATOMIC_BLOCK(ATOMIC_FORCEON)
    {
        counts_take(&left, &right);
        sample.ticks = clock_ticks();
    }
    sample.left += left;
    sample.right += right;
}

int main(void)
{
    pwm_init(); /* first, so that the motors rest */
    wdt_enable(WDTO_60MS);
    const uint8_t reset_cause = MCUCSR;
    MCUCSR = 0;
    clock_init();
    counts_init();
    nearby_init();
    uart_init();
    protocol_init(reset_cause);
    sei();

    for (;;) {
        uint8_t byte;
        wdt_reset();
        look();
        protocol_report(&sample);
        nearby_watch(sample.ticks);
        protocol_watch(sample.ticks);
        if (uart_receive(&byte))
            protocol_receive(&reader, byte, &sample);
    }
}
