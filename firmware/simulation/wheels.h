/* Two quadrature encoders on the chip's pins. */
#ifndef WHEELS_H
#define WHEELS_H

#include <stdbool.h>

enum wheel { LEFT, RIGHT };

/* Puts both encoders on the pins; to be repeated after the chip's reset. They start at position 0, both channels low. */
void wheels_connect(void);

/* After what the wheel has still to do, turns it by quarters of a pulse (forward positive), at `rate` pulses a second.
 * Answers false where too much is waiting. */
bool wheels_turn(enum wheel wheel, long quarters, double rate);

/* Inverts channel A for some cycles: a spike of noise. */
void wheels_spike(enum wheel wheel, unsigned cycles);

/* Quarters of a pulse since the start, and whether both wheels have done all they were told. */
long wheels_position(enum wheel wheel);
bool wheels_are_at_rest(void);

#endif
