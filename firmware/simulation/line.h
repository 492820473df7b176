/* The serial line: bytes that arrive at the chip at the line's pace, and those it sends, each with its cycle. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct sent {
    uint64_t cycle; /* when the byte began */
    uint8_t byte;
};

void line_start(void);

/* Queues bytes on their way to the chip; false where they are too many. */
bool line_send(const uint8_t *bytes, size_t count);
size_t line_waiting(void);

/* Takes what the chip has sent since the last call; valid until the chip runs again. */
const struct sent *line_take(size_t *count);

/* Received bytes that the program had not fetched, at most. The chip holds two, simavr more: above two, it would have
 * lost one. */
size_t line_most_unread(void);

/* From now on the chip's line is a pseudo-terminal, whose path this answers; a null pointer where there is none. */
const char *line_open_terminal(void);
void line_exchange(void);

#endif
