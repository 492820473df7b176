/* Counts of the two encoders, four a line, by TIM2 (left) and TIM3 (right). */
#ifndef COUNTS_H
#define COUNTS_H

#include <stdint.h>

void counts_init(void);

/* Counts since the last call, forward positive. To be called before a wheel makes 32768 of them, for TIM3 has 16 bits:
 * 81 ms at 400 000 a second; the main loop takes microseconds, and the watchdog bites earlier. */
void counts_take(int32_t *left, int32_t *right);

#endif
