/* What a builder may change: the crystal, the times. Pins are those of the timers: see board.c. */
#ifndef CONFIG_H
#define CONFIG_H

/* The Discovery's crystal X2, and what the PLL makes of it. */
#define HSE_HZ 8000000UL
#define CPU_HZ 168000000UL
#define APB1_HZ (CPU_HZ / 4)
#define APB1_TIMER_HZ (CPU_HZ / 2)
#define APB2_TIMER_HZ CPU_HZ

#define BAUD 115200UL

/* An edge counts where the line keeps its new level for 8 samples at an eighth of the timer's clock: 0.76 µs. Edges of
 * one channel that come 5 µs apart, as 400 000 counts a second make them, pass; spikes do not. */
#define ENCODER_FILTER 9

/* pid.codes' number for trials at home. Whoever gives boards away needs one of their own. */
#define USB_VENDOR 0x1209
#define USB_PRODUCT 0x0001

#define FRAME_MS 20
#define DRIVE_TIMEOUT_MS 250

/* The paper's bytes hold 127 pulses, and wheels of this board make more between two of them. */
#define HAS_PAPER 0
#define PAPER_FULL 100

#define VERSION_MAJOR 2
#define VERSION_MINOR 1

#endif
