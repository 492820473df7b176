#include "clock.h"

#include "config.h"
#include "registers.h"

uint16_t clock_ticks(void)
{
    return (uint16_t)TIM5->CNT;
}

uint32_t clock_us(uint16_t ticks)
{
    static uint32_t us;
    static uint16_t last_ticks;
    us += (uint16_t)(ticks - last_ticks);
    last_ticks = ticks;
    return us;
}

void clock_init(void)
{
    TIM5->PSC = APB1_TIMER_HZ / 1000000UL - 1;
    TIM5->ARR = 0xFFFFFFFF;
    TIM5->EGR = EGR_UG;
    TIM5->CR1 = CR1_CEN;
}
