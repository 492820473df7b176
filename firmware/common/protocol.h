/* What goes over the line: counts out, commands in. docs/firmware.md describes the bytes. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include "frame.h"

#include <stdint.h>

/* Both wheels at one instant: its time in clock ticks, and the pulses since the counts were last reset. */
struct sample {
    uint16_t ticks;
    uint32_t left;
    uint32_t right;
};

/* What bumpers and rangers saw: a bit for each bumper whose switch is open, and microseconds of each ranger's echo, 0 for
 * none and 65535 for a ranger that does not answer. */
struct nearby {
    uint8_t bumpers;
    uint16_t echo_us[4];
} __attribute__((packed));

/* `reset_cause` is told to the host with the version: 1 power-on, 2 the reset pin, 4 brown-out,
 * 8 the watchdog. */
void protocol_init(uint8_t reset_cause);

/* Sends the sample where, by the format in use, it is time to. */
void protocol_report(const struct sample *sample);

/* Sends what bumpers and rangers saw; the paper's format has no room for it. */
void protocol_report_nearby(const struct nearby *nearby);

/* Takes one byte from a host, over the line of that reader, and obeys where it ends a frame. The sample's counts begin anew if the host says so. */
void protocol_receive(struct frame_reader *reader, uint8_t byte, struct sample *sample);

/* Brings both motors to rest where the host has not driven for DRIVE_TIMEOUT_MS. */
void protocol_watch(uint16_t ticks);

#endif
