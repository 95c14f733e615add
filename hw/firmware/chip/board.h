/* Pins and clocks of the ATmega328P, with the names of an Arduino Nano beside them.
 *
 * PB0 D8   in   light barrier, high = interrupted (input capture; pulled by the receiver's output, not here)
 * PB1 D9   out  camera trigger, OC1A
 * PB2 D10  out  LED gate, OC1B; pull-down outside, for the time of a reset
 * PD2 D2   in   encoder A (INT0)           PD3 D3  in   encoder B (INT1)
 * PD4..PD7 D4..D7  out  LED channels 0 to 3; a LED is lit while its channel and the gate are both high
 * PC0 A0   out  line ready, high = a board may come; pull-down outside. A0, because bootloaders blink D13 and a
 *               programmer drives D11 to D13
 * PC1 A1   out  board available to the next machine, PC2 A2 failed board available; high = closed, pull-downs outside
 * PC3..PC5 A3..A5  in   board available and failed board available of the machine upstream, machine ready of the next one;
 *               low = closed (pulled by the receiver's output, not here)
 * PD0 RX, PD1 TX   serial port, 250 000 baud, which 16 MHz divides exactly (115 200 would be 2.1 % off)
 *
 * Port B is written only in outputs.c, and only with zeros: the compare units drive its outputs.
 */
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#if F_CPU != 16000000UL
#error "ticks are 0.5 us at 16 MHz"
#endif

#define BARRIER_PIN (1 << PB0)
#define TRIGGER_PIN (1 << PB1)
#define GATE_PIN (1 << PB2)
#define LINE_READY_PIN (1 << PC0)
#define AVAILABLE_OUT_PIN (1 << PC1)
#define FAILED_OUT_PIN (1 << PC2)
#define AVAILABLE_IN_PIN (1 << PC3)
#define FAILED_IN_PIN (1 << PC4)
#define NEXT_READY_PIN (1 << PC5)
#define CHANNEL_SHIFT PD4
#define CHANNEL_PINS (0xF << CHANNEL_SHIFT)
#define ENCODER_A (1 << PD2)
#define ENCODER_B (1 << PD3)
#define SERIAL_RX (1 << PD0)

#define BAUD_DIVIDER (F_CPU / 16 / 250000UL - 1)

/* Interval of the Timer 2 interrupt, which clocks the guard and wakes the main loop. */
#define GUARD_TICK_US 64

#endif
