#include "usb.h"

#include "clock.h"
#include "usb_core.h"
#include "usb_descriptors.h"

#include <stddef.h>
#include <string.h>

#define SERIAL 1 /* the endpoint, both ways */
#define NOTES 2
#define AWAY_MS 100 /* for a host to notice that the board has begun anew */

/* Powers of two, so that an index wraps by a mask. One place stays free, which tells full from empty. */
#define OUT_SIZE 1024u
#define IN_SIZE 256u

enum {
    GET_STATUS = 0,
    CLEAR_FEATURE = 1,
    SET_ADDRESS = 5,
    GET_DESCRIPTOR = 6,
    GET_CONFIGURATION = 8,
    SET_CONFIGURATION = 9,
    SET_INTERFACE = 11,
    SET_LINE_CODING = 0x20,
    GET_LINE_CODING = 0x21,
    SET_CONTROL_LINE_STATE = 0x22,
};

struct request {
    uint8_t type, what;
    uint16_t value, index, length;
};

static uint8_t out[OUT_SIZE], in[IN_SIZE];
static unsigned out_head, out_tail, in_head, in_tail;
static struct request request;
static uint8_t configuration, line_coding[7] = {0x00, 0xC2, 0x01, 0x00, 0, 0, 8}; /* 115200 8N1, which means nothing here */
static bool is_open, is_held;
static uint32_t away_ticks;

static unsigned used(unsigned head, unsigned tail, unsigned size)
{
    return (head - tail) & (size - 1);
}

static void forget(void)
{
    out_head = out_tail = in_head = in_tail = 0;
    configuration = 0;
    is_open = is_held = false;
}

static void configure(uint8_t value)
{
    forget();
    configuration = value;
    if (!value)
        return;
    usb_core_open_in(SERIAL, BULK, PACKET);
    usb_core_open_out(SERIAL, BULK, PACKET);
    usb_core_open_in(NOTES, INTERRUPT, 8);
}

/* A program opens the port by raising DTR: it gets nothing that was said before. */
static void set_open(bool is_so)
{
    if (configuration && is_so != is_open) {
        usb_core_flush(SERIAL);
        out_tail = out_head;
    }
    is_open = configuration && is_so;
}

static void answer(const uint8_t *bytes, unsigned length)
{
    usb_core_send(0, bytes, (uint8_t)(length < request.length ? length : request.length));
}

static void done(void)
{
    usb_core_send(0, NULL, 0);
}

static void get_descriptor(void)
{
    uint8_t length;
    const uint8_t *bytes = usb_descriptor(request.value, &length);
    if (bytes)
        answer(bytes, length);
    else
        usb_core_stall();
}

static void obey_standard(void)
{
    static const uint8_t zeros[2];
    switch (request.what) {
    case GET_STATUS:
        return answer(zeros, sizeof zeros);
    case GET_DESCRIPTOR:
        return get_descriptor();
    case GET_CONFIGURATION:
        return answer(&configuration, 1);
    case SET_ADDRESS:
        usb_core_set_address(request.value & 127);
        return done();
    case SET_CONFIGURATION:
        configure((uint8_t)request.value);
        return done();
    case CLEAR_FEATURE:
    case SET_INTERFACE:
        return done();
    default:
        usb_core_stall();
    }
}

static void obey_class(void)
{
    switch (request.what) {
    case SET_LINE_CODING:
        return; /* the coding itself comes next */
    case GET_LINE_CODING:
        return answer(line_coding, sizeof line_coding);
    case SET_CONTROL_LINE_STATE:
        set_open(request.value & 1);
        return done();
    default:
        usb_core_stall();
    }
}

static void obey(void)
{
    if (request.type & 0x60)
        obey_class();
    else
        obey_standard();
}

static void take(const struct usb_event *event)
{
    const uint8_t *bytes = (const uint8_t *)event->words;
    if (event->endpoint == 0 && request.what == SET_LINE_CODING && event->length == sizeof line_coding)
        memcpy(line_coding, bytes, sizeof line_coding);
    if (event->endpoint != SERIAL)
        return;
    for (unsigned i = 0; i < event->length; i++) {
        in[in_head] = bytes[i];
        in_head = (in_head + 1) & (IN_SIZE - 1);
    }
}

static void react(const struct usb_event *event)
{
    switch (event->kind) {
    case BUS_RESET:
        return forget();
    case SETUP:
        memcpy(&request, event->words, sizeof request);
        return;
    case SETUP_DONE:
        usb_core_expect(0);
        return obey();
    case DATA:
        return take(event);
    case DATA_DONE:
        if (event->endpoint == SERIAL) {
            is_held = true;
            return;
        }
        usb_core_expect(0);
        if (!(request.type & 0x80) && request.length)
            done();
        return;
    default:
        return;
    }
}

static void send_next(void)
{
    uint8_t packet[PACKET];
    unsigned length = 0;
    if (out_head == out_tail || !usb_core_is_free(SERIAL))
        return;
    while (length < PACKET - 1 && out_tail != out_head) { /* a full packet would have to be followed by an empty one */
        packet[length++] = out[out_tail];
        out_tail = (out_tail + 1) & (OUT_SIZE - 1);
    }
    usb_core_send(SERIAL, packet, (uint8_t)length);
}

static void connect_when_due(uint16_t ticks)
{
    static uint16_t last_ticks;
    if (away_ticks >= TICKS_PER_MS(AWAY_MS))
        return;
    away_ticks += (uint16_t)(ticks - last_ticks);
    last_ticks = ticks;
    if (away_ticks >= TICKS_PER_MS(AWAY_MS))
        usb_core_connect();
}

void usb_poll(uint16_t ticks)
{
    struct usb_event event;
    connect_when_due(ticks);
    usb_core_poll(&event);
    react(&event);
    if (is_held && IN_SIZE - 1 - used(in_head, in_tail, IN_SIZE) >= PACKET) {
        is_held = false; /* the host waits meanwhile, and loses nothing */
        usb_core_expect(SERIAL);
    }
    if (is_open)
        send_next();
}

bool usb_send(const uint8_t *bytes, uint8_t length)
{
    if (!is_open || length > OUT_SIZE - 1 - used(out_head, out_tail, OUT_SIZE))
        return false;
    while (length--) {
        out[out_head] = *bytes++;
        out_head = (out_head + 1) & (OUT_SIZE - 1);
    }
    return true;
}

bool usb_receive(uint8_t *byte)
{
    if (in_tail == in_head)
        return false;
    *byte = in[in_tail];
    in_tail = (in_tail + 1) & (IN_SIZE - 1);
    return true;
}

void usb_init(void)
{
    usb_core_init();
}
