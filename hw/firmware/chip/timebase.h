/* Timer 1, clk/8, extended to 32 bits by its overflows. */
#ifndef TIMEBASE_H
#define TIMEBASE_H

#include "ticks.h"

void timebase_start(void);
ticks_t timebase_now(void);
/* Extends a value of the timer that is at most 16 ms old; call with interrupts off. */
ticks_t timebase_extend(uint16_t count);

#endif
