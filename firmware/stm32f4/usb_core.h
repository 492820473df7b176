/* The USB core of the chip (OTG_FS) as a full-speed device: endpoints and their packets, after RM0090. */
#ifndef USB_CORE_H
#define USB_CORE_H

#include <stdbool.h>
#include <stdint.h>

#define PACKET 64

enum { CONTROL = 0, BULK = 2, INTERRUPT = 3 };

enum usb_event_kind { NOTHING, BUS_RESET, SETUP, SETUP_DONE, DATA, DATA_DONE };

struct usb_event {
    enum usb_event_kind kind;
    uint8_t endpoint;
    uint8_t length;
    uint32_t words[PACKET / 4]; /* what came, of SETUP and DATA */
};

/* Makes a device of the core, which takes it 25 ms. The line is not driven meanwhile: a host sees nothing plugged in. */
void usb_core_init(void);

/* Sets the device up and pulls the line up, which is how a host notices it; at least 25 ms after usb_core_init. */
void usb_core_connect(void);

/* What has happened next. */
void usb_core_poll(struct usb_event *event);

void usb_core_set_address(uint8_t address);
void usb_core_open_in(uint8_t endpoint, uint8_t type, uint8_t size);
void usb_core_open_out(uint8_t endpoint, uint8_t type, uint8_t size);

/* Lets the endpoint take the next packet. */
void usb_core_expect(uint8_t endpoint);

/* Whether an IN endpoint has sent what it was given. */
bool usb_core_is_free(uint8_t endpoint);

/* Gives an IN endpoint at most two packets to send. */
void usb_core_send(uint8_t endpoint, const uint8_t *bytes, uint8_t length);

/* Takes back what an IN endpoint has not sent. */
void usb_core_flush(uint8_t endpoint);

/* Refuses the request that is under way. */
void usb_core_stall(void);

#endif
