/* Trigger and LED gate by the compare units of Timer 1; Timer 2 guards the LEDs. */
#ifndef OUTPUTS_H
#define OUTPUTS_H

#include <stdint.h>

void outputs_start(void);
/* Count of Timer 2 interrupts; the watchdog is only served while it changes. */
uint8_t guard_ticks(void);

#endif
