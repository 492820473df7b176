/* Bumpers and ultrasonic rangers (HC-SR04 and the like), beside the wheels. docs/firmware.md has their pins. */
#ifndef NEARBY_H
#define NEARBY_H

#include <stdint.h>

#define RANGERS 4
#define BUMPERS 2

/* Looks at the pins at a time; to be called in each round. All rangers ping together every 50 ms. A ping's echoes are
 * sent before the next one, and a bumper that changes is sent at once. */
void nearby_watch(uint16_t ticks);

/* Of each board: levels of the pins, rangers' echoes from bit 0 on and bumpers after them; and the line that triggers
 * all rangers. */
uint8_t nearby_levels(void);
void nearby_trigger(uint8_t level);
void nearby_init(void);

#endif
