/* Registers of the STM32F407 that this program uses, after ST's reference manual RM0090. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

struct rcc {
    volatile uint32_t CR, PLLCFGR, CFGR, CIR, AHB1RSTR, AHB2RSTR, AHB3RSTR, reserved0, APB1RSTR, APB2RSTR, reserved1[2],
        AHB1ENR, AHB2ENR, AHB3ENR, reserved2, APB1ENR, APB2ENR, reserved3[2], AHB1LPENR, AHB2LPENR, AHB3LPENR, reserved4,
        APB1LPENR, APB2LPENR, reserved5[2], BDCR, CSR;
};

struct gpio {
    volatile uint32_t MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFR[2];
};

struct timer {
    volatile uint32_t CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, RCR, CCR1, CCR2, CCR3, CCR4, BDTR;
};

struct usart {
    volatile uint32_t SR, DR, BRR, CR1, CR2, CR3;
};

struct dma_stream {
    volatile uint32_t CR, NDTR, PAR, M0AR, M1AR, FCR;
};

struct iwdg {
    volatile uint32_t KR, PR, RLR, SR;
};

#define RCC ((struct rcc *)0x40023800)
#define FLASH_ACR (*(volatile uint32_t *)0x40023C00)
#define GPIOA ((struct gpio *)0x40020000)
#define GPIOB ((struct gpio *)0x40020400)
#define GPIOD ((struct gpio *)0x40020C00)
#define GPIOE ((struct gpio *)0x40021000)
#define TIM1 ((struct timer *)0x40010000)
#define TIM2 ((struct timer *)0x40000000)
#define TIM3 ((struct timer *)0x40000400)
#define TIM5 ((struct timer *)0x40000C00)
#define USART2 ((struct usart *)0x40004400)
#define DMA1_STREAM5 ((struct dma_stream *)0x40026088)
#define USB_AT(offset) (*(volatile uint32_t *)(0x50000000 + (offset)))
#define UNIQUE_ID ((const volatile uint32_t *)0x1FFF7A10)
#define IWDG ((struct iwdg *)0x40003000)

#define BIT(number) (1UL << (number))

/* RCC */
#define CR_HSEON BIT(16)
#define CR_HSERDY BIT(17)
#define CR_PLLON BIT(24)
#define CR_PLLRDY BIT(25)
#define PLLCFGR_HSE BIT(22)
#define CFGR_SW_PLL 2UL
#define CFGR_SWS 0xCUL
#define CFGR_SWS_PLL 0x8UL
#define CFGR_PPRE1_4 (5UL << 10)
#define CFGR_PPRE2_2 (4UL << 13)
#define AHB1ENR_GPIOA BIT(0)
#define AHB1ENR_GPIOB BIT(1)
#define AHB1ENR_GPIOD BIT(3)
#define AHB1ENR_GPIOE BIT(4)
#define AHB1ENR_DMA1 BIT(21)
#define AHB2ENR_OTGFS BIT(7)
#define APB1ENR_TIM2 BIT(0)
#define APB1ENR_TIM3 BIT(1)
#define APB1ENR_TIM5 BIT(3)
#define APB1ENR_USART2 BIT(17)
#define APB2ENR_TIM1 BIT(0)
#define CSR_RMVF BIT(24)
#define CSR_BORRSTF BIT(25)
#define CSR_PINRSTF BIT(26)
#define CSR_PORRSTF BIT(27)
#define CSR_IWDGRSTF BIT(29)

/* Flash: five wait states at 168 MHz, with prefetch and both caches */
#define ACR_FAST (5UL | BIT(8) | BIT(9) | BIT(10))

/* Timers */
#define CR1_CEN BIT(0)
#define CR1_ARPE BIT(7)
#define SMCR_ENCODER 3UL
#define CCMR1_INPUTS (BIT(0) | BIT(8))
#define CCMR1_FILTERS(code) ((uint32_t)(code) << 4 | (uint32_t)(code) << 12)
#define CCMR1_PWM (6UL << 4 | BIT(3) | 6UL << 12 | BIT(11))
#define CCER_CC1E BIT(0)
#define CCER_CC2E BIT(4)
#define EGR_UG BIT(0)
#define BDTR_MOE BIT(15)

/* USART */
#define USART_SR_TXE BIT(7)
#define USART_CR1_RE BIT(2)
#define USART_CR1_TE BIT(3)
#define USART_CR1_UE BIT(13)
#define USART_CR3_DMAR BIT(6)

/* DMA: channel 4 of stream 5 of DMA1 is what USART2 receives */
#define DMA_EN BIT(0)
#define DMA_CIRCULAR BIT(8)
#define DMA_MEMORY_STEPS BIT(10)
#define DMA_CHANNEL(number) ((uint32_t)(number) << 25)

/* Independent watchdog */
#define KR_FEED 0xAAAA
#define KR_UNLOCK 0x5555
#define KR_START 0xCCCC

#endif
