/* The serial line on the USART, 115200 baud 8N1, through two ring buffers. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Takes the next received byte; false where there is none. */
bool uart_receive(uint8_t *byte);

#endif
