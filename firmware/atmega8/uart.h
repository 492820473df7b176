/* The serial line on the USART, 115200 baud 8N1, through two ring buffers. */
#ifndef UART_H
#define UART_H

#include "line.h"

void uart_init(void);

#endif
