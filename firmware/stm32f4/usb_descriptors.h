/* What the board says it is: a serial port of class CDC, subclass ACM. */
#ifndef USB_DESCRIPTORS_H
#define USB_DESCRIPTORS_H

#include <stdint.h>

/* Bytes of a descriptor, by the request's value (type in the high byte, index in the low); their number in `length`.
 * A null pointer where there is none. What it answers lasts until the next call. */
const uint8_t *usb_descriptor(uint16_t value, uint8_t *length);

#endif
