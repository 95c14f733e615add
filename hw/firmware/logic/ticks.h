/* Time in ticks of Timer 1: 0.5 us each, 32 bits, which wrap after 35.8 minutes. */
#ifndef TICKS_H
#define TICKS_H

#include <stdint.h>

typedef uint32_t ticks_t;

#define TICKS_PER_US 2UL
#define US(us) ((us) * TICKS_PER_US)
#define MS(ms) ((ms) * 1000UL * TICKS_PER_US)

/* Positive if `a` is later than `b`; correct while they are less than 17.9 minutes apart. */
static inline int32_t ticks_since(ticks_t a, ticks_t b) { return (int32_t)(a - b); }

#endif
