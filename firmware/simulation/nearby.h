/* Ultrasonic rangers and bumpers on the ATmega8's pins. */
#ifndef NEARBY_SIMULATION_H
#define NEARBY_SIMULATION_H

#include <stdbool.h>

/* Puts them on the pins; to be repeated after the chip's reset. At the start no ranger has power, and all bumpers' switches
 * are closed. */
void nearby_connect(void);

/* From the next ping on a ranger's pulse lasts so long; 0 for one without power. False for a ranger that there is not. */
bool nearby_echo(int ranger, unsigned microseconds);

/* Opens a bumper's switch, as when it is pressed, or closes it. False for a bumper that there is not. */
bool nearby_bumper(int bumper, bool is_open);

#endif
