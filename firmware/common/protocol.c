#include "protocol.h"

#include "clock.h"
#include "config.h"
#include "pwm.h"
#include "line.h"

#include <stdbool.h>
#include <string.h>

#define PROTOCOL 1

enum { COUNTS = 0x01, VERSION = 0x02, ACK = 0x03, NEARBY = 0x04 };
enum { DRIVE = 0x81, STOP = 0x82, GET_VERSION = 0x83, RESET_COUNTS = 0x84, SET_FORMAT = 0x85 };
enum status { DONE, UNKNOWN_COMMAND, BAD_LENGTH, OUT_OF_RANGE };
enum format { FRAMED, PAPER };

static enum format format;
static uint8_t reset_cause;
static uint16_t reported_ticks;                 /* when counts were last sent */
static uint32_t reported_left, reported_right;  /* of which the host has been told, in either format */
static uint32_t silent_ticks;                   /* since the host last drove */

static void report_framed(const struct sample *sample)
{
    const struct {
        uint32_t clock_us, left, right;
    } body = {clock_us(sample->ticks), sample->left, sample->right};
    if (!frame_send(COUNTS, &body, sizeof body))
        return;
    reported_left = sample->left;
    reported_right = sample->right;
}

static int8_t fit(int16_t pulses)
{
    return pulses > 127 ? 127 : pulses < -127 ? -127 : pulses;
}

static void report_paper(int16_t left, int16_t right)
{
    const int8_t bytes[] = {fit(right), fit(left)};
    if (!line_send((const uint8_t *)bytes, sizeof bytes))
        return;
    reported_right += bytes[0];
    reported_left += bytes[1];
}

/* Of one sample, the last pair and the first frame: no pulse falls between the formats. */
static void end_pairs(const struct sample *sample)
{
    report_paper(sample->left - reported_left, sample->right - reported_right);
    frame_end();
    report_framed(sample);
}

static bool is_full(int16_t pulses)
{
    return pulses >= PAPER_FULL || pulses <= -PAPER_FULL;
}

void protocol_report(const struct sample *sample)
{
    const bool is_due = (uint16_t)(sample->ticks - reported_ticks) >= TICKS_PER_MS(FRAME_MS);
    const int16_t left = sample->left - reported_left;
    const int16_t right = sample->right - reported_right;

    if (format == FRAMED && is_due) {
        reported_ticks += TICKS_PER_MS(FRAME_MS);
        report_framed(sample);
    } else if (format == PAPER && (is_due || is_full(left) || is_full(right))) {
        reported_ticks = sample->ticks; /* from the last frame, early or not: there is a silence after each pair */
        report_paper(left, right);
    }
}

void protocol_report_nearby(const struct nearby *nearby)
{
    if (format == FRAMED)
        frame_send(NEARBY, nearby, sizeof *nearby);
}

static enum status drive(const struct frame *frame)
{
    int16_t duties[2];
    if (frame->length != sizeof duties)
        return BAD_LENGTH;
    memcpy(duties, frame->body, sizeof duties);
    for (uint8_t i = 0; i < 2; i++)
        if (duties[i] > DUTY_MAX || duties[i] < -DUTY_MAX)
            return OUT_OF_RANGE;
    pwm_set(duties[0], duties[1]);
    silent_ticks = 0;
    return DONE;
}

static enum status set_format(const struct frame *frame, const struct sample *sample)
{
    if (frame->length != 1)
        return BAD_LENGTH;
    if (frame->body[0] > (HAS_PAPER ? PAPER : FRAMED))
        return OUT_OF_RANGE;
    if (frame->body[0] == format)
        return DONE;
    format = frame->body[0];
    reported_ticks = sample->ticks;
    if (format == FRAMED)
        end_pairs(sample);
    return DONE;
}

static void send_version(void)
{
    const uint8_t body[] = {PROTOCOL, VERSION_MAJOR, VERSION_MINOR, reset_cause};
    frame_send(VERSION, body, sizeof body);
}

static void reset_counts(struct sample *sample)
{
    reported_left -= sample->left; /* what was not yet told is not forgotten */
    reported_right -= sample->right;
    sample->left = sample->right = 0;
}

static enum status obey(const struct frame *frame, struct sample *sample)
{
    if (frame->type == DRIVE)
        return drive(frame);
    if (frame->type == SET_FORMAT)
        return set_format(frame, sample);
    if (frame->type < DRIVE || frame->type > SET_FORMAT)
        return UNKNOWN_COMMAND;
    if (frame->length)
        return BAD_LENGTH;

    if (frame->type == STOP) {
        pwm_set(0, 0);
        silent_ticks = 0;
    } else if (frame->type == RESET_COUNTS) {
        reset_counts(sample);
    } else if (format == FRAMED) {
        send_version();
    }
    return DONE;
}

void protocol_receive(struct frame_reader *reader, uint8_t byte, struct sample *sample)
{
    const struct frame *frame = frame_receive(reader, byte);
    if (!frame)
        return;
    const enum format before = format;
    const uint8_t body[] = {frame->type, frame->sequence, obey(frame, sample)};
    /* The paper's two bytes leave no room for answers; a change of format is answered on its framed side. */
    if (before == FRAMED || format == FRAMED)
        frame_send(ACK, body, sizeof body);
}

void protocol_watch(uint16_t ticks)
{
    static uint16_t last_ticks;
    silent_ticks += (uint16_t)(ticks - last_ticks);
    last_ticks = ticks;
    if (silent_ticks >= TICKS_PER_MS(DRIVE_TIMEOUT_MS)) {
        pwm_set(0, 0);
        silent_ticks = 0;
    }
}

void protocol_init(uint8_t cause)
{
    reset_cause = cause;
    frame_end();
}
