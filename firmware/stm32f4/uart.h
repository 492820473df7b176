/* The serial line on USART2, 115200 baud 8N1, through two ring buffers, of which the DMA fills one by itself. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Queues all of the bytes, or none and answers false where they would not fit. */
bool uart_send(const uint8_t *bytes, uint8_t length);

/* Takes the next received byte; false where there is none. */
bool uart_receive(uint8_t *byte);

/* Sends the next byte where the line is free. What is received waits for 22 ms, whatever the program does. */
void uart_poll(void);

#endif
