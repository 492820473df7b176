/* Pulses of the two encoders. */
#ifndef COUNTS_H
#define COUNTS_H

#include <stdint.h>

void counts_init(void);

/* Pulses since the last call, forward positive. Interrupts must be off, so that both wheels are of one instant.
 * To be called at least every 63 pulses of a wheel: 8 ms at the paper's top speed; the main loop takes under 0.3 ms. */
void counts_take(int8_t *left, int8_t *right);

#endif
