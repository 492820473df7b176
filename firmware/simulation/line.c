#include "chip.h"
#include "line.h"

#include <fcntl.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_cycle_timers.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

DEFINE_FIFO(uint16_t, uart_fifo);

#define CYCLES_A_BYTE (CHIP_HZ / 11520)
#define INCOMING (1 << 16)

static uint8_t incoming[INCOMING];
static size_t incoming_first, incoming_count;
static size_t most_unread;

static struct sent *sent;
static size_t sent_count, sent_room;

static int terminal = -1;

static avr_irq_t *uart_irq(int index)
{
    return avr_io_getirq(chip, AVR_IOCTL_UART_GETIRQ('0'), index);
}

static avr_cycle_count_t deliver(avr_t *avr, avr_cycle_count_t when, void *parameter)
{
    (void)avr, (void)parameter;
    avr_raise_irq(uart_irq(UART_IRQ_INPUT), incoming[incoming_first]);
    incoming_first = (incoming_first + 1) % INCOMING;
    return --incoming_count ? when + CYCLES_A_BYTE : 0;
}

bool line_send(const uint8_t *bytes, size_t count)
{
    if (count > INCOMING - incoming_count)
        return false;
    if (!incoming_count && count)
        avr_cycle_timer_register(chip, CYCLES_A_BYTE, deliver, NULL);
    for (size_t i = 0; i < count; i++)
        incoming[(incoming_first + incoming_count++) % INCOMING] = bytes[i];
    return true;
}

size_t line_waiting(void)
{
    return incoming_count;
}

static void keep(uint8_t byte)
{
    if (sent_count == sent_room) {
        sent_room = sent_room ? 2 * sent_room : 1024;
        sent = realloc(sent, sent_room * sizeof *sent);
        if (!sent)
            abort();
    }
    sent[sent_count++] = (struct sent){chip->cycle, byte};
}

static void on_output(avr_irq_t *irq, uint32_t value, void *parameter)
{
    (void)irq, (void)parameter;
    const uint8_t byte = (uint8_t)value;
    if (terminal < 0)
        keep(byte);
    else if (write(terminal, &byte, 1) != 1)
        return; /* nobody reads; a line does not wait */
}

static void on_input(avr_irq_t *irq, uint32_t value, void *parameter)
{
    (void)irq, (void)value;
    avr_uart_t *uart = parameter;
    const size_t unread = uart_fifo_get_read_size(&uart->input);
    if (unread > most_unread)
        most_unread = unread;
}

const struct sent *line_take(size_t *count)
{
    *count = sent_count;
    sent_count = 0;
    return sent;
}

size_t line_most_unread(void)
{
    return most_unread;
}

const char *line_open_terminal(void)
{
    struct termios raw;
    terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (terminal < 0 || grantpt(terminal) || unlockpt(terminal) || tcgetattr(terminal, &raw))
        return NULL;
    cfmakeraw(&raw);
    tcsetattr(terminal, TCSANOW, &raw);
    /* Held open, so that the line is there before a program comes and after it has gone. */
    const char *path = ptsname(terminal);
    return path && open(path, O_RDWR | O_NOCTTY) >= 0 ? path : NULL;
}

void line_exchange(void)
{
    uint8_t bytes[256];
    if (terminal < 0 || incoming_count)
        return;
    const ssize_t count = read(terminal, bytes, sizeof bytes);
    if (count > 0)
        line_send(bytes, (size_t)count);
}

void line_start(void)
{
    for (avr_io_t *io = chip->io_port; io; io = io->next)
        if (io->irq == uart_irq(0))
            avr_irq_register_notify(uart_irq(UART_IRQ_INPUT), on_input, io);
    avr_irq_register_notify(uart_irq(UART_IRQ_OUTPUT), on_output, NULL);
}
