/* Trigger and LED gate by the compare units of Timer 1, and Timer 2 that guards the LEDs. */
#ifndef OUTPUTS_H
#define OUTPUTS_H

#include <stdint.h>

void outputs_start(void);
/* Counts interrupts of Timer 2; the watchdog wants to see it move. */
uint8_t guard_ticks(void);

#endif
