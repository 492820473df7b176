/* The serial line, 115200 baud 8N1, through two ring buffers. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Queues all of the bytes, or none and answers false where they would not fit. */
bool uart_send(const uint8_t *bytes, uint8_t length);

/* Takes the next received byte; false where there is none. */
bool uart_receive(uint8_t *byte);

#endif
