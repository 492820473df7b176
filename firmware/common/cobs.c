#include "cobs.h"

void cobs_encode(const uint8_t *bytes, uint8_t length, uint8_t *encoded)
{
    uint8_t *distance = encoded; /* where the way to the next zero will be written */
    *distance = 1;
    while (length--) {
        encoded++;
        if (*bytes) {
            *encoded = *bytes;
            ++*distance;
        } else {
            distance = encoded;
            *distance = 1;
        }
        bytes++;
    }
}

uint8_t cobs_decode(uint8_t *bytes, uint8_t length)
{
    uint8_t until_zero = length ? bytes[0] : 0;
    for (uint8_t i = 1; i < length; i++) {
        if (!until_zero)
            return 0;
        const uint8_t byte = bytes[i];
        bytes[i - 1] = --until_zero ? byte : 0;
        if (!until_zero)
            until_zero = byte;
    }
    return until_zero == 1 ? length - 1 : 0; /* the last way must end just beyond the last byte */
}
