/* The serial line, as each board's own file makes it. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stdint.h>

/* Queues all of the bytes, or none and answers false where they would not fit. */
bool line_send(const uint8_t *bytes, uint8_t length);

/* Takes the next received byte; false where there is none. */
bool line_receive(uint8_t *byte);

#endif
