#include "chip.h"

#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_elf.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define PAINT 0xA5
#define PORTB_ADDRESS 0x38
#define UBRRL_ADDRESS 0x29

avr_t *chip;
static avr_uart_t *uart;
static unsigned paint_begin;

static void log_errors(avr_t *avr, const int level, const char *format, va_list arguments)
{
    (void)avr;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, arguments);
}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles)
{
    (void)avr, (void)cycles; /* simavr would sleep on the wall's clock */
}

static avr_io_t *find(const char *kind, char name)
{
    for (avr_io_t *io = chip->io_port; io; io = io->next) {
        if (strcmp(io->kind, kind) != 0)
            continue;
        if (name == '\0' || ((avr_timer_t *)io)->name == name) /* a port's name is in the same place */
            return io;
    }
    return NULL;
}

static bool is_atmega8(void)
{
    return strcmp(CHIP, "atmega8") == 0;
}

/* simavr shares one description among chips of the ATmega8's kind, and it is another's in two points: the pins of
 * Timer1's outputs (here PB1 and PB2), and mode 14, which is fast PWM and not phase-correct. */
static void correct_timer1(void)
{
    avr_timer_t *timer = (avr_timer_t *)find("timer", '1');
    timer->comp[AVR_TIMER_COMPA].com_pin = (avr_regbit_t)AVR_IO_REGBIT(PORTB_ADDRESS, 1);
    timer->comp[AVR_TIMER_COMPB].com_pin = (avr_regbit_t)AVR_IO_REGBIT(PORTB_ADDRESS, 2);
    timer->wgm_op[14] = (avr_timer_wgm_t)AVR_TIMER_WGM_ICFASTPWM();
}

/* simavr reckons a parity bit into every byte and takes UCSRC for UBRRH, which share an address. */
static void correct_byte_time(void)
{
    uart->cycles_per_byte = 10 * 16 * (chip->data[UBRRL_ADDRESS] + 1);
}

avr_irq_t *chip_pin(char port, int pin)
{
    return avr_io_getirq(chip, AVR_IOCTL_IOPORT_GETIRQ(port), pin);
}

avr_io_addr_t chip_pins_address(char port)
{
    return ((avr_ioport_t *)find("port", port))->r_pin;
}

bool chip_start(const char *program)
{
    elf_firmware_t firmware = {0};
    avr_global_logger_set(log_errors);
    if (elf_read_firmware(program, &firmware) != 0)
        return false;
    chip = avr_make_mcu_by_name(CHIP);
    avr_init(chip);
    chip->frequency = CHIP_HZ;
    chip->sleep = no_sleep;
    avr_load_firmware(chip, &firmware);
    chip->frequency = CHIP_HZ;

    uart = (avr_uart_t *)find("uart", '\0');
    uart->flags = 0; /* no printing, no sleeping */
    if (is_atmega8())
        correct_timer1();
    paint_begin = 0x60 + firmware.datasize + firmware.bsssize;
    memset(chip->data + paint_begin, PAINT, chip->ramend + 1 - paint_begin);
    chip_reset();
    return true;
}

void chip_reset(void)
{
    avr_reset(chip);
}

bool chip_run(avr_cycle_count_t until)
{
    while (chip->cycle < until) {
        const int state = avr_run(chip);
        if (state == cpu_Done || state == cpu_Crashed)
            return false;
        if (is_atmega8())
            correct_byte_time();
    }
    return true;
}

void chip_hang(void)
{
    const avr_flashaddr_t last = chip->flashend - 1;
    chip->flash[last] = 0xFF; /* rjmp to itself */
    chip->flash[last + 1] = 0xCF;
    chip->pc = last;
}

unsigned chip_untouched_memory(void)
{
    unsigned end = paint_begin;
    while (end <= chip->ramend && chip->data[end] == PAINT)
        end++;
    return end - paint_begin;
}
