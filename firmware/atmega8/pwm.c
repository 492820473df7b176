#include "pwm.h"

#include "config.h"

#include <avr/io.h>

/* Timer1 counts 0…TOP and the pin is high for OCR + 1 of those: one step is half a permille of full scale. */
#define TOP (2 * DUTY_MAX - 1)

void pwm_set(int16_t left, int16_t right)
{
    /* The timer cannot make 0 %: the lowest duty takes its pin from the timer, and the port holds it low. */
    uint8_t outputs = 0;
    if (left > -DUTY_MAX) {
        OCR1A = DUTY_MAX - 1 + left;
        outputs |= _BV(COM1A1);
    }
    if (right > -DUTY_MAX) {
        OCR1B = DUTY_MAX - 1 + right;
        outputs |= _BV(COM1B1);
    }
    TCCR1A = outputs | _BV(WGM11);
}

void pwm_init(void)
{
    ICR1 = TOP;
    pwm_set(0, 0);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
    DDRB |= _BV(LEFT_PWM) | _BV(RIGHT_PWM);
}
