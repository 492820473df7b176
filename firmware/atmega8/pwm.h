/* Two analogue levels for the wheelchair's own controller: PWM at 7.4 kHz, smoothed outside. */
#ifndef PWM_H
#define PWM_H

#include <stdint.h>

#define DUTY_MAX 1000

/* Both outputs at rest. */
void pwm_init(void);

/* Duties in permille, −DUTY_MAX (0 V) through 0 (half scale: rest) to DUTY_MAX (full scale). */
void pwm_set(int16_t left, int16_t right);

#endif
