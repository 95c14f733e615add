/* A chip that only pretends, for the rules on a PC: its clock stands still until told, its pulses are booked. */
#ifndef PRETEND_H
#define PRETEND_H

#include "hardware.h"

void pretend_reset(ticks_t now);
void pretend_time(ticks_t now);
void pretend_encoder(int32_t position);
/* Pulses that rose since the last call of this. */
uint32_t pretend_pulses(void);
/* What was lit longer than limits.h allows, in words, or NULL. */
const char *pretend_offence(void);

#endif
