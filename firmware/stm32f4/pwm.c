#include "pwm.h"

#include "config.h"
#include "registers.h"

#define STEPS (2 * DUTY_MAX) /* of a period; one is half a permille of full scale */

void pwm_set(int16_t left, int16_t right)
{
    TIM1->CCR1 = (uint32_t)(DUTY_MAX + left); /* the pin is high for so many steps: none, or all, at the ends */
    TIM1->CCR2 = (uint32_t)(DUTY_MAX + right);
}

void pwm_init(void)
{
    TIM1->PSC = APB2_TIMER_HZ / (21000UL * STEPS) - 1;
    TIM1->ARR = STEPS - 1;
    TIM1->CCMR1 = CCMR1_PWM;
    pwm_set(0, 0);
    TIM1->CCER = CCER_CC1E | CCER_CC2E;
    TIM1->EGR = EGR_UG;
    TIM1->BDTR = BDTR_MOE;
    TIM1->CR1 = CR1_ARPE | CR1_CEN;
}

_Static_assert(APB2_TIMER_HZ % (21000UL * STEPS) == 0, "the period is no whole number of the timer's clocks");
