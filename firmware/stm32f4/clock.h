/* The controller's clock: TIM5 at 1 MHz. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

#define TICKS_PER_MS(ms) ((uint32_t)(ms) * 1000UL)

void clock_init(void);

/* Microseconds now; rolls over every 65.5 ms, so only differences of near times mean anything. */
uint16_t clock_ticks(void);

/* Microseconds since the start, at a time `ticks` less than 65.5 ms after that of the last call; rolls over at 2³². */
uint32_t clock_us(uint16_t ticks);

#endif
