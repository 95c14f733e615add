/* What the logic needs of the chip. chip/ implements it with registers, native/ by simulation for tests on a PC. */
#ifndef HARDWARE_H
#define HARDWARE_H

#include "protocol.h"

enum pulse { PULSE_NONE, PULSE_WAITING, PULSE_HIGH, PULSE_DONE, PULSE_CUT };

/* Gives one row to the compare units: both outputs rise at `due`. Returns 0, without effect, if `due` is too near. */
uint8_t pulse_start(ticks_t due, uint16_t trigger_width, const struct step *light);
/* The state of the pulse. PULSE_DONE and PULSE_CUT (by the guard) are returned once. */
uint8_t pulse_poll(void);
/* Cancels a pulse that has not risen; returns 0 if there is none. */
uint8_t pulse_cancel(void);
/* Switches all outputs low at once. */
void outputs_off(void);

/* Sets the output "line ready" and returns its level: it stays low while the barrier is blocked. */
uint8_t ready_output(uint8_t high);

/* The contacts of the neighbours that are closed: the inputs of enum contact. */
uint8_t contacts_read(void);
/* Closes the contacts to the next machine that are in `closed`, the outputs of enum contact, and opens the others. */
void contacts_output(uint8_t closed);

/* Encoder counts since the reset. */
int32_t encoder_position(void);
/* Records the time at which the encoder reaches a position; the present time if it is beyond it already. */
void encoder_watch(int32_t place);
/* True once after the watched position was reached; `when` is its time. */
uint8_t encoder_reached(ticks_t *when);

#endif
