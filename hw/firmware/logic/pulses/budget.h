/* The LED duty limit: a token bucket of light per channel that fills with 1/16 of the time. Constants in limits.h. */
#ifndef BUDGET_H
#define BUDGET_H

#include "protocol.h"

#define CHANNEL_NONE 0xFF

struct budget {
    uint16_t left[LED_CHANNELS]; /* ticks of light */
    ticks_t filled;              /* time of the last update */
};

extern const uint16_t led_longest[LED_CHANNELS];

/* Updates the buckets; must be called at least once in 17 minutes, or the time difference wraps. */
void budget_fill(struct budget *budget, ticks_t now);
/* Takes the light of a pulse from the buckets and returns CHANNEL_NONE; or returns a channel that lacks it, unchanged. */
uint8_t budget_take(struct budget *budget, ticks_t now, const struct step *step);
/* Returns a channel for which the pulse is too long, too short, or that does not exist; CHANNEL_NONE if all is well. */
uint8_t step_refused(const struct step *step);

#endif
