/* Two motor levels: PWM at 21 kHz, on TIM1. */
#ifndef PWM_H
#define PWM_H

#include <stdint.h>

#define DUTY_MAX 1000

/* Both outputs at rest. */
void pwm_init(void);

/* Duties in permille, −DUTY_MAX (always low) through 0 (half the time high: rest) to DUTY_MAX (always high). */
void pwm_set(int16_t left, int16_t right);

#endif
