/* Runs the controller's program on a simulated ATmega8, steered by lines on the standard input; each is answered by one
 * line, `ok …` or `error …`. Time is the chip's: it passes in `run`, and in `live`, where it keeps to the wall's clock.
 *
 *   run SECONDS               lets the time pass                          ok CYCLE
 *   rest                      until both wheels have done all their turns ok CYCLE
 *   turn WHEEL QUARTERS RATE  quarters of a pulse, pulses a second
 *   spike WHEEL CYCLES        channel A inverted for so long
 *   position                  quarters of a pulse                         ok LEFT RIGHT
 *   echo RANGER MICROSECONDS  length of its pulses; 0 without power
 *   bumper NUMBER OPEN        1 as when it is pressed, 0 else
 *   send HEX                  bytes to the chip, at the line's pace
 *   take                      bytes from the chip since last taken        ok CYCLE:HEX …
 *   pwm                       both outputs since last read                ok DRIVEN PERIODS DUTY HZ (twice)
 *   peek ADDRESS              one byte of memory, as the program sees it  ok VALUE
 *   memory                    bytes that the stack never reached          ok BYTES
 *   unread                    most received bytes not yet fetched         ok BYTES
 *   hang, reset               the main program stands still; power off and on
 *   terminal                  the line becomes a pseudo-terminal          ok PATH
 *   live, still               time keeps to the wall's clock between commands, or stands still (as at the start)
 */
#include "chip.h"
#include "line.h"
#include "meter.h"
#include "nearby.h"
#include "wheels.h"

#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define SLICE (CHIP_HZ / 200)
#define MOST_BEHIND (CHIP_HZ / 10)

static bool is_live;

static const char *run(const char *arguments)
{
    const double seconds = atof(arguments);
    if (!chip_run(chip->cycle + (avr_cycle_count_t)(seconds * CHIP_HZ)))
        return "the program has crashed";
    printf("ok %" PRIu64 "\n", chip->cycle);
    return NULL;
}

static const char *rest(const char *arguments)
{
    (void)arguments;
    while (!wheels_are_at_rest())
        if (!chip_run(chip->cycle + SLICE))
            return "the program has crashed";
    return run("0");
}

static bool parse_wheel(const char *name, enum wheel *wheel)
{
    *wheel = strcmp(name, "right") == 0 ? RIGHT : LEFT;
    return *wheel == RIGHT || strcmp(name, "left") == 0;
}

static const char *turn(const char *arguments)
{
    char name[8];
    enum wheel wheel;
    long quarters;
    double rate;
    if (sscanf(arguments, "%7s %ld %lf", name, &quarters, &rate) != 3 || !parse_wheel(name, &wheel) || !(rate > 0))
        return "turn takes left or right, quarters, and pulses a second above 0";
    if (!wheels_turn(wheel, quarters, rate))
        return "too many turns are waiting";
    return "";
}

static const char *spike(const char *arguments)
{
    char name[8];
    enum wheel wheel;
    unsigned cycles;
    if (sscanf(arguments, "%7s %u", name, &cycles) != 2 || !parse_wheel(name, &wheel) || !cycles)
        return "spike takes left or right, and cycles above 0";
    wheels_spike(wheel, cycles);
    return "";
}

static const char *position(const char *arguments)
{
    (void)arguments;
    printf("ok %ld %ld\n", wheels_position(LEFT), wheels_position(RIGHT));
    return NULL;
}

static const char *echo(const char *arguments)
{
    int ranger;
    unsigned microseconds;
    if (sscanf(arguments, "%d %u", &ranger, &microseconds) != 2 || !nearby_echo(ranger, microseconds))
        return "echo takes a ranger, 0 to 3, and microseconds";
    return "";
}

static const char *bumper(const char *arguments)
{
    int number, is_open;
    if (sscanf(arguments, "%d %d", &number, &is_open) != 2 || !nearby_bumper(number, is_open))
        return "bumper takes its number, 0 or 1, and 1 for open";
    return "";
}

static const char *send_bytes(const char *arguments)
{
    unsigned byte;
    for (; sscanf(arguments, "%2x", &byte) == 1; arguments += 2) {
        const uint8_t sent = (uint8_t)byte;
        if (!line_send(&sent, 1))
            return "too many bytes are on their way";
    }
    return "";
}

static const char *take(const char *arguments)
{
    (void)arguments;
    size_t count;
    const struct sent *sent = line_take(&count);
    printf("ok");
    for (size_t i = 0; i < count; i++)
        printf(" %" PRIu64 ":%02x", sent[i].cycle, sent[i].byte);
    printf("\n");
    return NULL;
}

static const char *pwm(const char *arguments)
{
    (void)arguments;
    printf("ok");
    for (int output = 0; output < 2; output++) {
        const struct reading reading = meter_read(output);
        printf(" %d %u %.6f %.2f", reading.is_driven, reading.periods, reading.duty, reading.hz);
    }
    printf("\n");
    return NULL;
}

static const char *peek(const char *arguments)
{
    const unsigned long address = strtoul(arguments, NULL, 0);
    if (address > chip->ramend)
        return "the chip has no such address";
    printf("ok %u\n", chip->data[address]);
    return NULL;
}

static const char *memory(const char *arguments)
{
    (void)arguments;
    printf("ok %u\n", chip_untouched_memory());
    return NULL;
}

static const char *unread(const char *arguments)
{
    (void)arguments;
    printf("ok %zu\n", line_most_unread());
    return NULL;
}

static const char *hang(const char *arguments)
{
    (void)arguments;
    chip_hang();
    return "";
}

static const char *reset(const char *arguments)
{
    (void)arguments;
    chip_reset();
    wheels_connect();
    nearby_connect();
    return "";
}

static const char *open_terminal(const char *arguments)
{
    (void)arguments;
    const char *path = line_open_terminal();
    if (!path)
        return "no pseudo-terminal could be opened";
    printf("ok %s\n", path);
    return NULL;
}

static const char *live(const char *arguments)
{
    (void)arguments;
    is_live = true;
    return "";
}

static const char *still(const char *arguments)
{
    (void)arguments;
    is_live = false;
    return "";
}

/* A command answers what was wrong; nothing ("") where all is well; or a null pointer where it has answered itself. */
static const struct {
    const char *name;
    const char *(*act)(const char *arguments);
} commands[] = {
    {"run", run},       {"rest", rest},     {"turn", turn},     {"spike", spike}, {"position", position},
    {"send", send_bytes}, {"take", take},   {"pwm", pwm},       {"peek", peek},   {"memory", memory},
    {"unread", unread}, {"hang", hang},     {"reset", reset},   {"terminal", open_terminal},
    {"live", live},     {"still", still},   {"echo", echo},     {"bumper", bumper},
};

static void obey(char *line)
{
    line[strcspn(line, "\n")] = '\0';
    char *arguments = line + strcspn(line, " ");
    if (*arguments)
        *arguments++ = '\0';
    const char *problem = "no such command";
    for (size_t i = 0; i < sizeof commands / sizeof *commands; i++)
        if (strcmp(line, commands[i].name) == 0)
            problem = commands[i].act(arguments);
    if (problem)
        printf(*problem ? "error %s\n" : "ok\n", problem);
    fflush(stdout);
}

static double wall_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Lets the chip catch up with the wall's clock; time that a busy machine could not give is left out. */
static bool keep_up(double *began_s)
{
    line_exchange();
    const avr_cycle_count_t now = (avr_cycle_count_t)((wall_s() - *began_s) * CHIP_HZ);
    if (now > chip->cycle + MOST_BEHIND)
        *began_s = wall_s() - (double)chip->cycle / CHIP_HZ;
    return chip_run(now < chip->cycle + SLICE ? now : chip->cycle + SLICE);
}

/* simavr says on the standard output what belongs on the other. */
static bool start_quietly(const char *program)
{
    const int answers = dup(STDOUT_FILENO);
    dup2(STDERR_FILENO, STDOUT_FILENO);
    const bool has_started = chip_start(program);
    fflush(stdout);
    dup2(answers, STDOUT_FILENO);
    return has_started;
}

int main(int argc, char **argv)
{
    static char line[1 << 17];
    struct pollfd input = {.fd = 0, .events = POLLIN};
    double began_s = 0;

    if (argc != 2 || !start_quietly(argv[1])) {
        fprintf(stderr, "usage: chip PROGRAM.elf\n");
        return 2;
    }
    wheels_connect();
    nearby_connect();
    line_start();
    meter_start();
    setvbuf(stdin, NULL, _IONBF, 0);

    for (;;) {
        const bool was_live = is_live;
        if (!is_live || poll(&input, 1, 1)) {
            if (!fgets(line, sizeof line, stdin))
                return 0;
            obey(line);
        }
        if (is_live && !was_live)
            began_s = wall_s() - (double)chip->cycle / CHIP_HZ;
        if (is_live && !keep_up(&began_s)) {
            fprintf(stderr, "the program has crashed\n");
            return 1;
        }
    }
}
