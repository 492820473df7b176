/* Consistent overhead byte stuffing (Cheshire & Baker 1999): frames without zeros, so that a zero ends a frame.
 * For frames under 254 bytes, where the overhead is one byte. */
#ifndef COBS_H
#define COBS_H

#include <stdint.h>

/* Writes length + 1 bytes to `encoded`, none of them zero. */
void cobs_encode(const uint8_t *bytes, uint8_t length, uint8_t *encoded);

/* Decodes in place; answers the decoded length, one less than `length`, or 0 where these bytes are no encoding. */
uint8_t cobs_decode(uint8_t *bytes, uint8_t length);

#endif
