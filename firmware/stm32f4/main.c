/* Wheel controller for the STM32F4 Discovery: timers count two encoders, and a host on USB or the UART has the counts
 * and drives two motors. There are no interrupts: the hardware counts, and a round of the loop is shorter than a byte. */
#include "board.h"
#include "clock.h"
#include "counts.h"
#include "line.h"
#include "nearby.h"
#include "protocol.h"
#include "pwm.h"
#include "uart.h"
#include "usb.h"

static struct sample sample;
static struct frame_reader uart_reader, usb_reader;

/* Whoever listens hears all: the one on the UART decides what is lost, for USB takes more. */
bool line_send(const uint8_t *bytes, uint8_t length)
{
    usb_send(bytes, length);
    return uart_send(bytes, length);
}

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
    nearby_init();
    uart_init();
    usb_init();
    protocol_init(reset_cause);

    for (;;) {
        uint8_t byte;
        board_feed_watchdog();
        uart_poll();
        usb_poll(sample.ticks);
        look();
        protocol_report(&sample);
        nearby_watch(sample.ticks);
        protocol_watch(sample.ticks);
        if (uart_receive(&byte))
            protocol_receive(&uart_reader, byte, &sample);
        if (usb_receive(&byte))
            protocol_receive(&usb_reader, byte, &sample);
    }
}
