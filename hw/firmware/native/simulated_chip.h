/* A simulated chip for tests on a PC: its clock advances only by chip_advance, and its light is
 * checked against limits.h. */
#ifndef SIMULATED_CHIP_H
#define SIMULATED_CHIP_H

#include "hardware.h"

void chip_reset(ticks_t now);
void chip_advance(ticks_t now);
void chip_set_encoder(int32_t position);
/* Count of pulses that rose since the last call. */
uint32_t chip_pulses(void);
/* Level of the output "line ready". */
uint8_t chip_ready(void);
/* Closes these contacts of the neighbours, and opens the others. */
void chip_close(uint8_t contacts);
/* The contacts to the next machine that are closed. */
uint8_t chip_offered(void);
/* The first violation of limits.h in words, or NULL. */
const char *chip_violation(void);

#endif
