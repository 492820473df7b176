#include "chip.h"
#include "wheels.h"

#include <simavr/avr_ioport.h>
#include <simavr/sim_cycle_timers.h>
#include <stdlib.h>

#define QUEUE 4096

struct turn {
    long quarters;
    double cycles_per_quarter;
};

struct encoder {
    int a, b; /* pins of port D */
    long position;
    double next; /* cycle of the next edge */
    struct turn turns[QUEUE];
    unsigned first, count;
};

static struct encoder encoders[] = {[LEFT] = {.a = 2, .b = 4}, [RIGHT] = {.a = 3, .b = 5}};

/* Forward, A leads B by a quarter: (A, B) = 00, 10, 11, 01. */
static bool level_a(long position)
{
    const long phase = position & 3;
    return phase == 1 || phase == 2;
}

static unsigned levels(const struct encoder *encoder)
{
    return level_a(encoder->position) << encoder->a | level_a(encoder->position - 1) << encoder->b;
}

static void show(const struct encoder *encoder)
{
    avr_raise_irq(chip_pin('D', encoder->a), level_a(encoder->position));
    avr_raise_irq(chip_pin('D', encoder->b), level_a(encoder->position - 1));
}

void wheels_connect(void)
{
    avr_ioport_external_t external = {.name = 'D'};
    for (enum wheel wheel = LEFT; wheel <= RIGHT; wheel++) {
        const struct encoder *encoder = &encoders[wheel];
        show(encoder);
        external.mask |= 1 << encoder->a | 1 << encoder->b;
        external.value |= levels(encoder);
    }
    /* simavr would let a pull-up win over the encoder, and forgets the pins' levels when it resets. */
    avr_ioctl(chip, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &external);
    chip->data[chip_pins_address('D')] = external.value;
}

static avr_cycle_count_t step(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)avr, (void)when;
    struct encoder *encoder = parameter;
    struct turn *turn = &encoder->turns[encoder->first];
    const long direction = turn->quarters > 0 ? 1 : -1;

    encoder->position += direction;
    turn->quarters -= direction;
    show(encoder);
    if (!turn->quarters) {
        encoder->first = (encoder->first + 1) % QUEUE;
        if (!--encoder->count)
            return 0;
    }
    encoder->next += encoder->turns[encoder->first].cycles_per_quarter;
    return (avr_cycle_count_t)encoder->next;
}

bool wheels_turn(enum wheel wheel, long quarters, double rate)
{
    struct encoder *encoder = &encoders[wheel];
    if (encoder->count == QUEUE)
        return false;
    if (!quarters)
        return true;
    const struct turn turn = {quarters, CHIP_HZ / rate / 4};
    encoder->turns[(encoder->first + encoder->count++) % QUEUE] = turn;
    if (encoder->count == 1) {
        encoder->next = (double)chip->cycle + turn.cycles_per_quarter;
        avr_cycle_timer_register(chip, (avr_cycle_count_t)turn.cycles_per_quarter, step, encoder);
    }
    return true;
}

static avr_cycle_count_t end_spike(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)avr, (void)when;
    show(parameter);
    return 0;
}

void wheels_spike(enum wheel wheel, unsigned cycles)
{
    struct encoder *encoder = &encoders[wheel];
    avr_raise_irq(chip_pin('D', encoder->a), !level_a(encoder->position));
    avr_cycle_timer_register(chip, cycles, end_spike, encoder);
}

long wheels_position(enum wheel wheel)
{
    return encoders[wheel].position;
}

bool wheels_are_at_rest(void)
{
    return !encoders[LEFT].count && !encoders[RIGHT].count;
}
