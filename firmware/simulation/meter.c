#include "chip.h"
#include "meter.h"

#define DDRB_ADDRESS 0x37

struct output {
    int pin; /* of port B */
    bool level;
    uint64_t first_rise, last_rise, last_change;
    uint64_t high, high_until_last_rise; /* cycles since the first rise */
    unsigned rises;
};

static struct output outputs[] = {{.pin = 1}, {.pin = 2}};

static void on_change(avr_irq_t *irq, uint32_t value, void *parameter)
{
    (void)irq;
    struct output *output = parameter;
    const bool level = value & 1;
    if (level == output->level)
        return;
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
