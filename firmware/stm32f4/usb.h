/* The same line over USB: a serial port (CDC-ACM) on the board's socket CN5, which needs no driver. */
#ifndef USB_H
#define USB_H

#include <stdbool.h>
#include <stdint.h>

void usb_init(void);

/* Does what the bus has asked for. To be called at least every millisecond; `ticks` is the clock's time. */
void usb_poll(uint16_t ticks);

/* Queues all of the bytes, or none and answers false where they would not fit or no program has opened the port. */
bool usb_send(const uint8_t *bytes, uint8_t length);

/* Takes the next received byte; false where there is none. */
bool usb_receive(uint8_t *byte);

#endif
