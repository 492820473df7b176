#include "pwm.h"

#include "config.h"

#include <avr/io.h>
#include <stdbool.h>

/* Timer1 counts 0…TOP and the pin is high for OCR + 1 of those: one step is half a permille of full scale. */
#define TOP (2 * DUTY_MAX - 1)

/* Sets the duty of one output; answers whether the timer can make it. The ends, 0 % and 100 %, it cannot. */
static bool compare(int16_t duty, volatile uint16_t *at)
{
    if (duty <= -DUTY_MAX || duty >= DUTY_MAX)
        return false;
    *at = DUTY_MAX - 1 + duty;
    return true;
}

/* Holds still a pin that was taken from the timer. */
static void hold(int16_t duty, uint8_t pin)
{
    if (duty <= -DUTY_MAX)
        PORTB &= ~_BV(pin);
    if (duty >= DUTY_MAX)
        PORTB |= _BV(pin);
}

void pwm_set(int16_t left, int16_t right)
{
    uint8_t outputs = 0;
    if (compare(left, &OCR1A))
        outputs |= _BV(COM1A1);
    if (compare(right, &OCR1B))
        outputs |= _BV(COM1B1);
    TCCR1A = outputs | _BV(WGM11);
    hold(left, LEFT_PWM);
    hold(right, RIGHT_PWM);
}

void pwm_init(void)
{
    ICR1 = TOP;
    pwm_set(0, 0);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
    DDRB |= _BV(LEFT_PWM) | _BV(RIGHT_PWM);
}
