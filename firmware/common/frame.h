/* Frames on the line: type, sequence, body, CRC-16, in COBS, ended by a zero. */
#ifndef FRAME_H
#define FRAME_H

#include <stdbool.h>
#include <stdint.h>

#define FRAME_BODY_MAX 12 /* of those sent; received ones are shorter */

struct frame {
    uint8_t type;
    uint8_t sequence;
    const uint8_t *body;
    uint8_t length; /* of the body */
};

/* Sends a frame, or none, and answers false, where the line is behind; its sequence is used up either way, so that the
 * host sees the gap. */
bool frame_send(uint8_t type, const void *body, uint8_t length);

/* Ends what was sent before in another format, so that it does not spoil the next frame. */
void frame_end(void);

/* What of a frame has come over one line; all zero at first. */
struct frame_reader {
    uint8_t bytes[16];
    uint8_t length;
    bool is_too_long;
};

/* Takes the next byte of a line; answers the frame it ends, which lasts until the next call, or a null pointer.
 * Whatever is no frame is passed over in silence. */
const struct frame *frame_receive(struct frame_reader *reader, uint8_t byte);

#endif
