#include "usb_descriptors.h"

#include "config.h"
#include "registers.h"

#include <stddef.h>

enum { DEVICE = 1, CONFIGURATION = 2, STRING = 3 };

#define LOW(word) ((word) & 0xFF)
#define HIGH(word) ((word) >> 8)

static const uint8_t device[] = {
    18, DEVICE, 0x00, 0x02, 2, 0, 0, 64, LOW(USB_VENDOR), HIGH(USB_VENDOR), LOW(USB_PRODUCT), HIGH(USB_PRODUCT),
    VERSION_MINOR, VERSION_MAJOR, 1, 2, 3, 1,
};

static const uint8_t configuration[] = {
    9, CONFIGURATION, 67, 0, 2, 1, 0, 0xC0, 50,             /* two interfaces, self-powered */
    9, 4, 0, 0, 1, 2, 2, 0, 0,                              /* control: CDC, ACM */
    5, 0x24, 0, 0x10, 0x01, 5, 0x24, 1, 0, 1, 4, 0x24, 2, 2, 5, 0x24, 6, 0, 1,
    7, 5, 0x82, 3, 8, 0, 255,                               /* its notes, of which none is ever sent */
    9, 4, 1, 0, 2, 10, 0, 0, 0,                             /* data */
    7, 5, 0x01, 2, 64, 0, 0,                                /* from the host */
    7, 5, 0x81, 2, 64, 0, 0,                                /* to the host */
};

_Static_assert(sizeof configuration == 67, "the configuration says a wrong length");

static uint8_t string[2 + 2 * 24];

static const uint8_t *ascii(const char *text, uint8_t *length)
{
    uint8_t count = 2;
    for (; *text && count < sizeof string; text++) {
        string[count++] = (uint8_t)*text;
        string[count++] = 0;
    }
    string[0] = *length = count;
    string[1] = STRING;
    return string;
}

/* The chip's own number: /dev/serial/by-id tells two boards from each other. */
static const uint8_t *serial_number(uint8_t *length)
{
    char digits[25] = {0};
    for (unsigned i = 0; i < 24; i++)
        digits[i] = "0123456789ABCDEF"[UNIQUE_ID[i / 8] >> (28 - 4 * (i % 8)) & 15];
    return ascii(digits, length);
}

static const uint8_t *text(uint8_t index, uint8_t *length)
{
    static const uint8_t languages[] = {4, STRING, 0x09, 0x04};
    switch (index) {
    case 0:
        *length = sizeof languages;
        return languages;
    case 1:
        return ascii("wheelsight", length);
    case 2:
        return ascii("wheel controller", length);
    case 3:
        return serial_number(length);
    default:
        return NULL;
    }
}

const uint8_t *usb_descriptor(uint16_t value, uint8_t *length)
{
    switch (value >> 8) {
    case DEVICE:
        *length = sizeof device;
        return device;
    case CONFIGURATION:
        *length = sizeof configuration;
        return configuration;
    case STRING:
        return text(value & 0xFF, length);
    default:
        return NULL;
    }
}
