/* What a builder may change: the clock, the wiring, the times. */
#ifndef CONFIG_H
#define CONFIG_H

/* 14.7456 MHz divides to 115200 baud without error, and to 20 ms in whole overflows of Timer0. */
#define F_CPU 14745600UL
#define BAUD 115200UL

/* Port D. The channels A stand on INT0 and INT1, which are fixed pins; the channels B may move within the port. */
#define LEFT_A 2
#define RIGHT_A 3
#define LEFT_B 4
#define RIGHT_B 5

/* Port B. Timer1's outputs, fixed pins. */
#define LEFT_PWM 1
#define RIGHT_PWM 2

/* Bumpers, whose switches lead to ground and open when pressed, and rangers. Port C (0 and 1 stay free for analogue inputs) and
 * port D; the trigger of all rangers on port B. */
#define ECHO_0 2
#define ECHO_1 3
#define BUMPER_0 4
#define BUMPER_1 5
#define ECHO_2 6
#define ECHO_3 7
#define TRIGGER 0

/* 2: both edges of channel A, so that a count is a function of the wheel's position alone.
 * 1: the rising edge alone; a wheel that trembles on that edge drifts. */
#ifndef EDGES
#define EDGES 2
#endif

#define FRAME_MS 20

/* A robot at 1 m/s is to stop after 0.3 m without a host. The host sends every 50 ms at the latest: four commands may be
 * lost, and its own time-out, 200 ms, comes first. */
#define DRIVE_TIMEOUT_MS 250

/* The paper's frame holds ±127 pulses a wheel; one is sent early when a count reaches this. */
#define PAPER_FULL 100
#define HAS_PAPER 1

#define VERSION_MAJOR 1
#define VERSION_MINOR 2

#endif
