#include "usb_core.h"

#include "registers.h"

#include <string.h>

#define GUSBCFG USB_AT(0x00C)
#define GRSTCTL USB_AT(0x010)
#define GINTSTS USB_AT(0x014)
#define GRXSTSP USB_AT(0x020)
#define GRXFSIZ USB_AT(0x024)
#define DIEPTXF0 USB_AT(0x028)
#define GCCFG USB_AT(0x038)
#define DIEPTXF(n) USB_AT(0x100 + 4 * (n)) /* from 1 on */
#define DCFG USB_AT(0x800)
#define DCTL USB_AT(0x804)
#define DIEPCTL(n) USB_AT(0x900 + 0x20 * (n))
#define DIEPTSIZ(n) USB_AT(0x910 + 0x20 * (n))
#define DOEPCTL(n) USB_AT(0xB00 + 0x20 * (n))
#define DOEPTSIZ(n) USB_AT(0xB10 + 0x20 * (n))
#define PCGCCTL USB_AT(0xE00)
#define FIFO(n) USB_AT(0x1000 * ((n) + 1))

#define GUSBCFG_PHYSEL BIT(6)
#define GUSBCFG_TRDT (6UL << 10) /* for an AHB above 32 MHz */
#define GUSBCFG_FDMOD BIT(30)
#define GRSTCTL_CSRST BIT(0)
#define GRSTCTL_RXFFLSH BIT(4)
#define GRSTCTL_TXFFLSH BIT(5)
#define GRSTCTL_TXFNUM(n) ((uint32_t)(n) << 6)
#define GRSTCTL_AHBIDL BIT(31)
#define ALL_FIFOS 16
#define GINTSTS_RXFLVL BIT(4)
#define GINTSTS_USBRST BIT(12)
#define GINTSTS_ENUMDNE BIT(13)
#define GCCFG_PWRDWN BIT(16)
#define GCCFG_NOVBUSSENS BIT(21)
#define DCFG_FULL_SPEED 3UL
#define DCFG_ADDRESS (127UL << 4)
#define DCTL_SDIS BIT(1)
#define EP_ACTIVE BIT(15)
#define EP_TYPE(type) ((uint32_t)(type) << 18)
#define EP_STALL BIT(21)
#define EP_FIFO(n) ((uint32_t)(n) << 22)
#define EP_CNAK BIT(26)
#define EP_SNAK BIT(27)
#define EP_DATA0 BIT(28)
#define EP_DISABLE BIT(30)
#define EP_ENABLE BIT(31)
#define SIZE_PACKETS(n) ((uint32_t)(n) << 19)
#define SIZE_SETUPS (3UL << 29)

/* Words of the core's memory, 320 in all: what is received, and what each IN endpoint sends. */
enum { RX_WORDS = 128, TX0_WORDS = 32, TX1_WORDS = 64, TX2_WORDS = 16 };

static void flush(uint32_t fifos)
{
    GRSTCTL = fifos;
    while (GRSTCTL & (GRSTCTL_RXFFLSH | GRSTCTL_TXFFLSH))
        ;
}

void usb_core_init(void)
{
    GUSBCFG = GUSBCFG_PHYSEL;
    while (!(GRSTCTL & GRSTCTL_AHBIDL))
        ;
    GRSTCTL = GRSTCTL_CSRST;
    while (GRSTCTL & GRSTCTL_CSRST)
        ;
    GUSBCFG = GUSBCFG_PHYSEL | GUSBCFG_FDMOD | GUSBCFG_TRDT;
}

void usb_core_connect(void)
{
    DCTL = DCTL_SDIS;
    PCGCCTL = 0;
    DCFG = DCFG_FULL_SPEED;
    GRXFSIZ = RX_WORDS;
    DIEPTXF0 = TX0_WORDS << 16 | RX_WORDS;
    DIEPTXF(1) = TX1_WORDS << 16 | (RX_WORDS + TX0_WORDS);
    DIEPTXF(2) = TX2_WORDS << 16 | (RX_WORDS + TX0_WORDS + TX1_WORDS);
    flush(GRSTCTL_TXFFLSH | GRSTCTL_TXFNUM(ALL_FIFOS));
    flush(GRSTCTL_RXFFLSH);
    GCCFG = GCCFG_PWRDWN | GCCFG_NOVBUSSENS;
    DCTL = 0;
}

static void begin_anew(void)
{
    DCFG &= ~DCFG_ADDRESS;
    flush(GRSTCTL_TXFFLSH | GRSTCTL_TXFNUM(ALL_FIFOS));
    DOEPCTL(1) = EP_SNAK;
    usb_core_expect(0);
}

static void take(struct usb_event *event)
{
    static const uint8_t kinds[16] = {[2] = DATA, [3] = DATA_DONE, [4] = SETUP_DONE, [6] = SETUP};
    const uint32_t status = GRXSTSP;
    event->kind = kinds[status >> 17 & 15];
    event->endpoint = status & 15;
    const unsigned length = status >> 4 & 0x7FF;
    event->length = (uint8_t)(length < PACKET ? length : PACKET);
    for (unsigned i = 0; i < (length + 3) / 4; i++) {
        const uint32_t word = FIFO(0); /* read out even where it is too long, or the next packet is not found */
        if (i < PACKET / 4)
            event->words[i] = word;
    }
}

void usb_core_poll(struct usb_event *event)
{
    const uint32_t state = GINTSTS;
    event->kind = NOTHING;
    if (state & GINTSTS_USBRST) {
        GINTSTS = GINTSTS_USBRST;
        begin_anew();
        event->kind = BUS_RESET;
    } else if (state & GINTSTS_ENUMDNE) {
        GINTSTS = GINTSTS_ENUMDNE;
        DIEPCTL(0) = 0; /* packets of 64 bytes */
    } else if (state & GINTSTS_RXFLVL) {
        take(event);
    }
}

void usb_core_set_address(uint8_t address)
{
    DCFG = (DCFG & ~DCFG_ADDRESS) | (uint32_t)address << 4;
}

void usb_core_open_in(uint8_t endpoint, uint8_t type, uint8_t size)
{
    DIEPCTL(endpoint) = EP_ACTIVE | EP_TYPE(type) | EP_FIFO(endpoint) | EP_DATA0 | EP_SNAK | size;
}

void usb_core_open_out(uint8_t endpoint, uint8_t type, uint8_t size)
{
    DOEPCTL(endpoint) = EP_ACTIVE | EP_TYPE(type) | EP_DATA0 | size;
    usb_core_expect(endpoint);
}

void usb_core_expect(uint8_t endpoint)
{
    DOEPTSIZ(endpoint) = (endpoint ? 0 : SIZE_SETUPS) | SIZE_PACKETS(1) | PACKET;
    DOEPCTL(endpoint) |= EP_ENABLE | EP_CNAK;
}

bool usb_core_is_free(uint8_t endpoint)
{
    return !(DIEPCTL(endpoint) & EP_ENABLE);
}

void usb_core_send(uint8_t endpoint, const uint8_t *bytes, uint8_t length)
{
    const unsigned packets = length ? (length + PACKET - 1u) / PACKET : 1;
    DIEPTSIZ(endpoint) = SIZE_PACKETS(packets) | length;
    DIEPCTL(endpoint) |= EP_ENABLE | EP_CNAK;
    for (unsigned at = 0; at < length; at += 4) {
        uint32_t word = 0;
        memcpy(&word, bytes + at, length - at < 4 ? length - at : 4);
        FIFO(endpoint) = word;
    }
}

void usb_core_flush(uint8_t endpoint)
{
    if (DIEPCTL(endpoint) & EP_ENABLE) {
        DIEPCTL(endpoint) |= EP_SNAK | EP_DISABLE;
        while (DIEPCTL(endpoint) & EP_ENABLE)
            ;
    }
    flush(GRSTCTL_TXFFLSH | GRSTCTL_TXFNUM(endpoint));
}

void usb_core_stall(void)
{
    DIEPCTL(0) |= EP_STALL; /* the next SETUP ends it */
}
