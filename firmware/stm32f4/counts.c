#include "counts.h"

#include "config.h"
#include "registers.h"

static uint32_t last_left;
static uint16_t last_right;

void counts_take(int32_t *left, int32_t *right)
{
    const uint32_t left_now = TIM2->CNT;
    const uint16_t right_now = (uint16_t)TIM3->CNT;
    *left = (int32_t)(left_now - last_left);
    *right = (int16_t)(uint16_t)(right_now - last_right);
    last_left = left_now;
    last_right = right_now;
}

static void start(struct timer *timer, uint32_t top)
{
    timer->ARR = top;
    timer->CCMR1 = CCMR1_INPUTS | CCMR1_FILTERS(ENCODER_FILTER);
    timer->SMCR = SMCR_ENCODER;
    timer->EGR = EGR_UG;
    timer->CR1 = CR1_CEN;
}

void counts_init(void)
{
    start(TIM2, 0xFFFFFFFF);
    start(TIM3, 0xFFFF);
    last_left = TIM2->CNT;
    last_right = (uint16_t)TIM3->CNT;
}
