/* What is done once: clocks, pins, the watchdog, why the chip was reset. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Why the chip was reset, as protocol_init takes it, and forgets it. */
uint8_t board_reset_cause(void);

/* Starts the watchdog, which nothing but a reset stops: it bites 31 to 86 ms after it was last fed, for its oscillator is
 * anywhere from 17 to 47 kHz; 45 ms are usual. */
void board_start_watchdog(void);
void board_feed_watchdog(void);

/* The PLL at 168 MHz from the crystal, and clocks for what this program uses. Never ends without a crystal: the watchdog
 * then starts the chip anew, for ever, with motors at rest. */
void board_start_clocks(void);

/* Gives the pins to their timers and the line, and lights the green LED. */
void board_connect_pins(void);

#endif
