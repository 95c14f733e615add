/* Timer 1, clk/8, extended to 32 bits by its overflows. */
#ifndef TIMEBASE_H
#define TIMEBASE_H

#include "ticks.h"

void timebase_start(void);
ticks_t timebase_now(void);
/* When a 16-bit value of the timer, not older than 16 ms, was there. Interrupts are off. */
ticks_t timebase_extend(uint16_t count);

#endif
