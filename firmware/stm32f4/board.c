#include "board.h"

#include "config.h"
#include "registers.h"

#define GREEN_LED 12

enum pull { NO_PULL, PULL_UP };

uint8_t board_reset_cause(void)
{
    const uint32_t cause = RCC->CSR;
    RCC->CSR = CSR_RMVF;
    return (uint8_t)((cause & CSR_PORRSTF ? 1 : 0) | (cause & CSR_PINRSTF ? 2 : 0) | (cause & CSR_BORRSTF ? 4 : 0) |
                     (cause & CSR_IWDGRSTF ? 8 : 0));
}

void board_start_watchdog(void)
{
    IWDG->KR = KR_START;
    IWDG->KR = KR_UNLOCK;
    IWDG->PR = 1; /* an eighth of 17 to 47 kHz, of which 32 are usual */
    IWDG->RLR = 180;
    IWDG->KR = KR_FEED;
}

void board_feed_watchdog(void)
{
    IWDG->KR = KR_FEED;
}

void board_start_clocks(void)
{
    FLASH_ACR = ACR_FAST;
    RCC->CR |= CR_HSEON;
    while (!(RCC->CR & CR_HSERDY))
        ;
    /* 1 MHz × 336 / 2 = 168 MHz, and / 7 = 48 MHz */
    RCC->PLLCFGR = HSE_HZ / 1000000UL | 336UL << 6 | PLLCFGR_HSE | 7UL << 24;
    RCC->CR |= CR_PLLON;
    while (!(RCC->CR & CR_PLLRDY))
        ;
    RCC->CFGR = CFGR_PPRE1_4 | CFGR_PPRE2_2 | CFGR_SW_PLL;
    while ((RCC->CFGR & CFGR_SWS) != CFGR_SWS_PLL)
        ;
    RCC->AHB1ENR |= AHB1ENR_GPIOA | AHB1ENR_GPIOB | AHB1ENR_GPIOD | AHB1ENR_GPIOE | AHB1ENR_DMA1;
    RCC->AHB2ENR |= AHB2ENR_OTGFS;
    RCC->APB1ENR |= APB1ENR_TIM2 | APB1ENR_TIM3 | APB1ENR_TIM5 | APB1ENR_USART2;
    RCC->APB2ENR |= APB2ENR_TIM1;
    (void)RCC->APB2ENR; /* a peripheral is ready two of its clocks after it was given one */
}

static void connect(struct gpio *port, unsigned pin, unsigned function, enum pull pull)
{
    port->AFR[pin / 8] = (port->AFR[pin / 8] & ~(15UL << pin % 8 * 4)) | (uint32_t)function << pin % 8 * 4;
    port->PUPDR = (port->PUPDR & ~(3UL << 2 * pin)) | (uint32_t)pull << 2 * pin;
    port->MODER = (port->MODER & ~(3UL << 2 * pin)) | 2UL << 2 * pin;
}

void board_connect_pins(void)
{
    connect(GPIOA, 15, 1, PULL_UP); /* TIM2: left A, and B */
    connect(GPIOB, 3, 1, PULL_UP);
    connect(GPIOB, 4, 2, PULL_UP); /* TIM3: right A, and B */
    connect(GPIOB, 5, 2, PULL_UP);
    connect(GPIOA, 2, 7, NO_PULL); /* USART2: TX, and RX */
    connect(GPIOA, 3, 7, PULL_UP);
    connect(GPIOA, 11, 10, NO_PULL); /* USB: D−, and D+ */
    connect(GPIOA, 12, 10, NO_PULL);
    connect(GPIOE, 9, 1, NO_PULL); /* TIM1: left motor, and right */
    connect(GPIOE, 11, 1, NO_PULL);
    GPIOD->MODER |= 1UL << 2 * GREEN_LED;
    GPIOD->BSRR = BIT(GREEN_LED);
}
