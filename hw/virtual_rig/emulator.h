/* The emulated chip (emulator.c), and its serial port as a pseudo terminal in real time (terminal.c). */
#ifndef EMULATOR_H
#define EMULATOR_H

#include <sim_avr.h>

#include <stddef.h>
#include <stdint.h>

#define HZ 16000000UL
#define COMMAND_LONGEST ((1 << 20) + 16)

extern avr_t *avr;

/* Queues bytes for the UART, which receives them at its baud rate. */
void send_to_chip(const uint8_t *bytes, size_t count);
/* Runs the chip; returns 0 if it crashed. */
int run(avr_cycle_count_t cycles);

/* Runs until stdin ends; `execute_line` is called with every line of it. */
int terminal_serve(const char *link, void (*execute_line)(const char *line));
int terminal_is_used(void);
void terminal_put(uint8_t byte);
/* Executes a command of the terminal; returns 0 if it is none. */
int terminal_execute(const char *line);
/* Holds the chip for a time, as its bootloader does; bytes that arrive meanwhile are dropped. */
void terminal_hold(unsigned ms);

#endif
