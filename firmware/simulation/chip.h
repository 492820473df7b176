/* The simulated chip, CHIP of simavr's names, and its simulated time, CHIP_HZ cycles a second (both of the Makefile). */
#ifndef CHIP_H
#define CHIP_H

#include <simavr/sim_avr.h>
#include <stdbool.h>

extern avr_t *chip;

/* Loads the program of an ELF file and starts it; false where it cannot be read. */
bool chip_start(const char *program);

/* Power off and on: registers and peripherals begin anew. */
void chip_reset(void);

/* Runs until this cycle; false where the program has crashed. */
bool chip_run(avr_cycle_count_t until);

/* The main program loops for ever from now on, interrupts go on: what the hardware watchdog is for. */
void chip_hang(void);

/* The line of a port's pin (port 'B', pin 1 for PB1). */
avr_irq_t *chip_pin(char port, int pin);

/* Where the program reads the levels of a port's pins. */
avr_io_addr_t chip_pins_address(char port);

/* Bytes of memory that the stack has never reached. */
unsigned chip_untouched_memory(void);

#endif
