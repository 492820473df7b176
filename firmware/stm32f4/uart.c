#include "uart.h"

#include "config.h"
#include "registers.h"

/* Powers of two, so that an index wraps by a mask. One place of `out` stays free, which tells full from empty. */
#define OUT_SIZE 256u
#define IN_SIZE 256u

static uint8_t out[OUT_SIZE];
static unsigned out_head, out_tail;
static volatile uint8_t in[IN_SIZE]; /* written by the DMA, from the beginning again when it is full */
static unsigned in_tail;

void uart_poll(void)
{
    if (out_tail == out_head || !(USART2->SR & USART_SR_TXE))
        return;
    USART2->DR = out[out_tail];
    out_tail = (out_tail + 1) & (OUT_SIZE - 1);
}

bool uart_send(const uint8_t *bytes, uint8_t length)
{
    const unsigned room = (out_tail - out_head - 1) & (OUT_SIZE - 1);
    if (length > room)
        return false;
    while (length--) {
        out[out_head] = *bytes++;
        out_head = (out_head + 1) & (OUT_SIZE - 1);
    }
    return true;
}

bool uart_receive(uint8_t *byte)
{
    const unsigned head = (IN_SIZE - DMA1_STREAM5->NDTR) & (IN_SIZE - 1);
    if (in_tail == head)
        return false;
    *byte = in[in_tail];
    in_tail = (in_tail + 1) & (IN_SIZE - 1);
    return true;
}

void uart_init(void)
{
    DMA1_STREAM5->PAR = (uint32_t)&USART2->DR;
    DMA1_STREAM5->M0AR = (uint32_t)in;
    DMA1_STREAM5->NDTR = IN_SIZE;
    DMA1_STREAM5->CR = DMA_CHANNEL(4) | DMA_MEMORY_STEPS | DMA_CIRCULAR;
    DMA1_STREAM5->CR |= DMA_EN;
    USART2->BRR = (APB1_HZ + BAUD / 2) / BAUD; /* 0.11 % slow; 2 % do no harm */
    USART2->CR3 = USART_CR3_DMAR;
    USART2->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE;
}
