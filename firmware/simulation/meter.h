/* What a voltmeter sees on the two PWM pins. */
#ifndef METER_H
#define METER_H

#include <stdbool.h>
#include <stdint.h>

struct reading {
    bool is_driven;   /* false: the pin is an input, the level is whatever stands outside */
    unsigned periods; /* whole ones, from rising edge to rising edge; with none, the level stood still */
    double duty;      /* share of the time spent high */
    double hz;
};

void meter_start(void);

/* The reading of output 0 (OC1A) or 1 (OC1B) since the last call. */
struct reading meter_read(int output);

#endif
