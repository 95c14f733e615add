/* What the rules ask of the chip. chip/ does it with registers; native/ pretends, for tests on a PC. */
#ifndef HARDWARE_H
#define HARDWARE_H

#include "protocol.h"

enum pulse { PULSE_NONE, PULSE_WAITING, PULSE_HIGH, PULSE_DONE, PULSE_CUT };

/* Hand one row to the compare units: both outputs rise at `due`. 0 if that is too near; nothing happens then. */
uint8_t pulse_start(ticks_t due, uint16_t trigger_width, const struct step *light);
/* PULSE_DONE and PULSE_CUT (by the guard) are told once. */
uint8_t pulse_look(void);
/* Take back a pulse whose edge has not come; 0 if there is none. */
uint8_t pulse_cancel(void);
/* All outputs low, now. */
void outputs_off(void);

int32_t encoder_position(void);
/* Note when the encoder gets to a place, or that it is beyond already. */
void encoder_watch(int32_t place);
uint8_t encoder_reached(ticks_t *when);

#endif
