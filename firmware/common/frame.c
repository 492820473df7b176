#include "frame.h"

#include "cobs.h"
#include "crc.h"
#include "line.h"

#include <stddef.h>
#include <string.h>

#define HEADER 2
#define CRC 2

static bool send_zero_ended(const uint8_t *bytes, uint8_t length)
{
    uint8_t encoded[HEADER + FRAME_BODY_MAX + CRC + 2];
    cobs_encode(bytes, length, encoded);
    encoded[length + 1] = 0;
    return line_send(encoded, length + 2);
}

bool frame_send(uint8_t type, const void *body, uint8_t length)
{
    static uint8_t sequence;
    uint8_t bytes[HEADER + FRAME_BODY_MAX + CRC] = {type, sequence++};
    memcpy(bytes + HEADER, body, length);
    length += HEADER;
    const uint16_t crc = crc16(bytes, length);
    memcpy(bytes + length, &crc, CRC); /* both chips are little-endian, as the line is */
    return send_zero_ended(bytes, length + CRC);
}

void frame_end(void)
{
    static const uint8_t zero;
    line_send(&zero, 1);
}

static const struct frame *check(uint8_t *bytes, uint8_t length)
{
    static struct frame frame;
    length = cobs_decode(bytes, length);
    if (length < HEADER + CRC)
        return NULL;
    length -= CRC;
    if (crc16(bytes, length) != (bytes[length] | (uint16_t)bytes[length + 1] << 8))
        return NULL;
    frame = (struct frame){bytes[0], bytes[1], bytes + HEADER, length - HEADER};
    return &frame;
}

const struct frame *frame_receive(struct frame_reader *reader, uint8_t byte)
{
    if (byte && reader->length < sizeof reader->bytes) {
        reader->bytes[reader->length++] = byte;
        return NULL;
    }
    if (byte) {
        reader->is_too_long = true;
        return NULL;
    }
    const struct frame *frame = reader->is_too_long ? NULL : check(reader->bytes, reader->length);
    reader->length = 0;
    reader->is_too_long = false;
    return frame;
}
