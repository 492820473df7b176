/* Where frames are sent: each board's own file says how. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stdint.h>

/* Queues all of the bytes, or none and answers false where they would not fit. */
bool line_send(const uint8_t *bytes, uint8_t length);

#endif
