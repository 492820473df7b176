#include "nearby.h"

#include "clock.h"
#include "protocol.h"

#include <string.h>

#define PING_TICKS TICKS_PER_MS(50)  /* a ranger without an echo ends its pulse after 38 ms */
#define FAR_TICKS TICKS_PER_MS(25)   /* 4.3 m: farther echoes are none */
#define TRIGGER_TICKS (TICKS_PER_MS(1) / 50) /* 20 µs; rangers need 10 */
#define NO_ANSWER 0xFFFF

static uint16_t pinged;                        /* when the last ping began */
static uint8_t is_triggered;
static uint8_t was_high, has_risen, has_fallen; /* a bit for each ranger, since then */
static uint8_t seen_levels;
static uint16_t seen; /* when the pins were last looked at */
static uint16_t rose[RANGERS], lasted[RANGERS];
static struct nearby sent;

static uint8_t bumpers(uint8_t levels)
{
    return levels >> RANGERS & ((1 << BUMPERS) - 1);
}

/* A pulse lasts from when it was first seen to when it was last seen, so a distance is rather too short. */
static void follow(uint8_t ranger, uint8_t is_high, uint16_t ticks)
{
    const uint8_t bit = 1 << ranger;
    if (!(has_risen & bit)) {
        if (is_high && !(was_high & bit)) {
            has_risen |= bit;
            rose[ranger] = ticks;
        }
    } else if (!(has_fallen & bit) && !is_high) {
        has_fallen |= bit;
        lasted[ranger] = seen - rose[ranger];
    }
}

/* Microseconds of an echo; 0 where nothing is within reach. A pin that never rose, or is still high at the next ping,
 * is that of a ranger without power or with a cut cable. */
static uint16_t echo_us(uint8_t ranger)
{
    if (!(has_fallen & 1 << ranger))
        return NO_ANSWER;
    if (lasted[ranger] >= FAR_TICKS)
        return 0;
    return (uint16_t)((uint32_t)lasted[ranger] * 100000 / TICKS_PER_MS(100));
}

void nearby_watch(uint16_t ticks)
{
    const uint8_t levels = nearby_levels();
    const uint16_t since = ticks - pinged;
    if (is_triggered && since >= TRIGGER_TICKS) {
        is_triggered = 0;
        nearby_trigger(0);
    }
    for (uint8_t i = 0; levels != seen_levels && i < RANGERS; i++)
        follow(i, levels >> i & 1, ticks);
    seen_levels = levels;
    seen = ticks;
    if (since >= PING_TICKS) {
        for (uint8_t i = 0; i < RANGERS; i++)
            sent.echo_us[i] = echo_us(i);
        pinged += PING_TICKS; /* in step with the counts, which are sent before, so that they are never late */
        was_high = levels;
        has_risen = has_fallen = 0;
        is_triggered = 1;
        nearby_trigger(1);
    } else if (bumpers(levels) == sent.bumpers) {
        return;
    }
    sent.bumpers = bumpers(levels);
    protocol_report_nearby(&sent);
}
