#include "nearby.h"

#include "chip.h"

#include <simavr/avr_ioport.h>
#include <simavr/sim_cycle_timers.h>
#include <string.h>

#define RANGERS 4
#define BUMPERS 2
#define DELAY_US 450 /* from the trigger's end to the pulse, in which a ranger pings */
#define LEAST_TRIGGER_US 10

struct ranger {
    char port;
    int pin;
    unsigned echo_us;
};

static struct ranger rangers[RANGERS] = {{'C', 2, 0}, {'C', 3, 0}, {'D', 6, 0}, {'D', 7, 0}};
static const int bumper_pins[BUMPERS] = {4, 5}; /* of port C */
static avr_cycle_count_t trigger_rose;

static avr_cycle_count_t fall(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)avr, (void)when;
    const struct ranger *ranger = parameter;
    avr_raise_irq(chip_pin(ranger->port, ranger->pin), 0);
    return 0;
}

static avr_cycle_count_t rise(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)when;
    struct ranger *ranger = parameter;
    avr_raise_irq(chip_pin(ranger->port, ranger->pin), 1);
    avr_cycle_timer_register_usec(avr, ranger->echo_us, fall, ranger);
    return 0;
}

static void trigger(avr_irq_t *irq, uint32_t level, void *parameter)
{
    (void)irq, (void)parameter;
    if (level & 1) {
        trigger_rose = chip->cycle;
        return;
    }
    if (!trigger_rose || chip->cycle - trigger_rose < (avr_cycle_count_t)LEAST_TRIGGER_US * CHIP_HZ / 1000000)
        return;
    for (int i = 0; i < RANGERS; i++)
        if (rangers[i].echo_us)
            avr_cycle_timer_register_usec(chip, DELAY_US, rise, &rangers[i]);
}

void nearby_connect(void)
{
    static bool is_watched;
    if (!is_watched && strcmp(CHIP, "atmega8") == 0)
        avr_irq_register_notify(chip_pin('B', 0), trigger, NULL);
    is_watched = true;
    /* Without this, simavr would let the pull-ups win. */
    avr_ioport_external_t external = {.name = 'C', .mask = 1 << bumper_pins[0] | 1 << bumper_pins[1]};
    avr_ioctl(chip, AVR_IOCTL_IOPORT_SET_EXTERNAL('C'), &external);
    for (int i = 0; i < RANGERS; i++)
        avr_raise_irq(chip_pin(rangers[i].port, rangers[i].pin), rangers[i].echo_us == 0);
    for (int i = 0; i < BUMPERS; i++)
        nearby_bumper(i, false);
}

bool nearby_echo(int ranger, unsigned microseconds)
{
    if (ranger < 0 || ranger >= RANGERS)
        return false;
    rangers[ranger].echo_us = microseconds;
    avr_raise_irq(chip_pin(rangers[ranger].port, rangers[ranger].pin), microseconds == 0);
    return true;
}

bool nearby_bumper(int bumper, bool is_open)
{
    if (bumper < 0 || bumper >= BUMPERS)
        return false;
    avr_raise_irq(chip_pin('C', bumper_pins[bumper]), is_open);
    return true;
}
