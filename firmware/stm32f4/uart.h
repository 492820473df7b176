/* The serial line on USART2, 115200 baud 8N1, through two ring buffers, of which the DMA fills one by itself. */
#ifndef UART_H
#define UART_H

#include "line.h"

void uart_init(void);

/* Sends the next byte where the line is free. What is received waits for 22 ms, whatever the program does. */
void uart_poll(void);

#endif
