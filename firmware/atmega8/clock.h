/* The controller's clock: Timer0 at F_CPU / 64, 4.34 µs a tick. */
#ifndef CLOCK_H
#define CLOCK_H

#include "config.h"

#include <stdint.h>

#define TICKS_PER_MS(ms) ((uint32_t)(ms) * (F_CPU / 64UL) / 1000UL)

void clock_init(void);

/* Ticks now; rolls over every 284 ms, so only differences of near times mean anything. Interrupts must be off. */
uint16_t clock_ticks(void);

/* Microseconds since the start, at a time `ticks` less than 284 ms after that of the last call; rolls over at 2³². */
uint32_t clock_us(uint16_t ticks);

#endif
