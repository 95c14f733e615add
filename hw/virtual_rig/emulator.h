/* The emulated chip (emulator.c), and its serial line behind a terminal at the pace of the clock (terminal.c). */
#ifndef EMULATOR_H
#define EMULATOR_H

#include <sim_avr.h>

#include <stddef.h>
#include <stdint.h>

#define HZ 16000000UL
#define COMMAND_LONGEST ((1 << 20) + 16)

extern avr_t *avr;

/* Bytes that reach the UART one after another, at its pace. */
void send_to_chip(const uint8_t *bytes, size_t count);
/* 0 if it has executed nonsense. */
int run(avr_cycle_count_t cycles);

/* Runs until stdin ends; `answer` is called with every line of it. */
int terminal_serve(const char *link, void (*answer)(const char *line));
int terminal_is_used(void);
void terminal_put(uint8_t byte);
/* Whether the command was one of the terminal's. */
int terminal_obeys(const char *line);
/* The chip stands still for a time, as in its bootloader, and what comes meanwhile is swallowed. */
void terminal_hold(unsigned ms);

#endif
