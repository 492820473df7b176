/* Wheel controller for the STM32F4 Discovery: timers count two encoders, and a host on the serial line has the counts and
 * drives two motors. There are no interrupts: the hardware counts, and a round of the loop is shorter than a byte. */
#include "board.h"
#include "clock.h"
#include "counts.h"
#include "protocol.h"
#include "pwm.h"
#include "uart.h"

static struct sample sample;

static void look(void)
{
    int32_t left, right;
    sample.ticks = clock_ticks();
    counts_take(&left, &right);
    sample.left += (uint32_t)left;
    sample.right += (uint32_t)right;
}

int main(void)
{
    board_start_watchdog();
    const uint8_t reset_cause = board_reset_cause();
    board_start_clocks();
    pwm_init(); /* before the pins, so that the motors rest */
    board_connect_pins();
    clock_init();
    counts_init();
    uart_init();
    protocol_init(reset_cause);

    for (;;) {
        uint8_t byte;
        board_feed_watchdog();
        uart_poll();
        look();
        protocol_report(&sample);
        protocol_watch(sample.ticks);
        if (line_receive(&byte))
            protocol_receive(byte, &sample);
    }
}
