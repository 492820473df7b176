#include "chip.h"
#include "meter.h"

#include <simavr/sim_cycle_timers.h>

#define DDRB_ADDRESS 0x37
#define PORTB_IO 0x18
#define TCCR1A_ADDRESS 0x4F

struct output {
    int pin; /* of port B */
    bool level;
    uint64_t first_rise, last_rise, last_change;
    uint64_t high, high_until_last_rise; /* cycles since the first rise */
    unsigned rises;
};

static struct output outputs[] = {{.pin = 1}, {.pin = 2}};

/* simavr lets a write of another bit of the port win over the timer, which drives this pin in truth: sbi or cbi at PORTB
 * is no edge, and the pin is put back. */
static bool is_port_write(const struct output *output)
{
    const unsigned opcode = chip->flash[chip->pc] | chip->flash[chip->pc + 1] << 8;
    const bool is_bit = (opcode & 0xFDF8) == (0x9800 | PORTB_IO << 3);
    return is_bit && chip->data[TCCR1A_ADDRESS] & (output->pin == 1 ? 0x80 : 0x20);
}

static avr_cycle_count_t put_back(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)avr, (void)when;
    const struct output *output = parameter;
    avr_raise_irq(chip_pin('B', output->pin), output->level);
    return 0;
}

static void on_change(avr_irq_t *irq, uint32_t value, void *parameter)
{
    (void)irq;
    struct output *output = parameter;
    const bool level = value & 1;
    if (level == output->level)
        return;
    if (is_port_write(output)) {
        avr_cycle_timer_register(chip, 1, put_back, output);
        return;
    }
    const uint64_t now = chip->cycle;
    output->level = level;
    if (!level) {
        output->high += now - output->last_change;
    } else {
        output->rises++;
        output->last_rise = now;
        output->high_until_last_rise = output->high;
        if (output->rises == 1) {
            output->first_rise = now;
            output->high = output->high_until_last_rise = 0;
        }
    }
    output->last_change = now;
}

void meter_start(void)
{
    for (int i = 0; i < 2; i++)
        avr_irq_register_notify(chip_pin('B', outputs[i].pin), on_change, &outputs[i]);
}

struct reading meter_read(int index)
{
    struct output *output = &outputs[index];
    struct reading reading = {
        .is_driven = chip->data[DDRB_ADDRESS] & (1 << output->pin),
        .duty = output->level,
    };
    if (output->rises > 1) {
        const double cycles = (double)(output->last_rise - output->first_rise);
        reading.periods = output->rises - 1;
        reading.duty = (double)output->high_until_last_rise / cycles;
        reading.hz = CHIP_HZ * reading.periods / cycles;
    }
    output->rises = 0;
    return reading;
}
