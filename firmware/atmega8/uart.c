#include "uart.h"

#include "config.h"
#include "line.h"

#include <avr/interrupt.h>
#include <avr/io.h>

/* Powers of two, so that an index wraps by a mask. One place stays free, which tells full from empty. */
#define OUT_SIZE 128
#define IN_SIZE 64

static volatile uint8_t out[OUT_SIZE], out_head, out_tail;
static volatile uint8_t in[IN_SIZE], in_head, in_tail;

ISR(USART_UDRE_vect)
{
    const uint8_t tail = out_tail;
    const uint8_t next = (tail + 1) & (OUT_SIZE - 1);
    UDR = out[tail];
    out_tail = next;
    if (next == out_head)
        UCSRB &= ~_BV(UDRIE);
}

ISR(USART_RXC_vect)
{
    const uint8_t head = in_head;
    const uint8_t next = (head + 1) & (IN_SIZE - 1);
    const uint8_t byte = UDR;
    if (next == in_tail)
        return; /* A byte too many: the checksum will refuse its frame. */
    in[head] = byte;
    in_head = next;
}

bool line_send(const uint8_t *bytes, uint8_t length)
{
    uint8_t head = out_head;
    const uint8_t room = (out_tail - head - 1) & (OUT_SIZE - 1);
    if (length > room)
        return false;
    while (length--) {
        out[head] = *bytes++;
        head = (head + 1) & (OUT_SIZE - 1);
    }
    out_head = head;
    UCSRB |= _BV(UDRIE);
    return true;
}

bool uart_receive(uint8_t *byte)
{
    const uint8_t tail = in_tail;
    if (tail == in_head)
        return false;
    *byte = in[tail];
    in_tail = (tail + 1) & (IN_SIZE - 1);
    return true;
}

void uart_init(void)
{
    UBRRH = 0;
    UBRRL = F_CPU / (16 * BAUD) - 1;
    UCSRC = _BV(URSEL) | _BV(UCSZ1) | _BV(UCSZ0);
    UCSRB = _BV(RXEN) | _BV(TXEN) | _BV(RXCIE);
}

_Static_assert(F_CPU % (16 * BAUD) == 0, "the baud rate has an error with this clock");
