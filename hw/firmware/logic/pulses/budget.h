/* How much light each channel may still give: a bucket that fills with 1/16 of the time. Constants in limits.h. */
#ifndef BUDGET_H
#define BUDGET_H

#include "protocol.h"

#define CHANNEL_NONE 0xFF

struct budget {
    uint16_t left[LED_CHANNELS]; /* ticks of light */
    ticks_t filled;              /* when they were last brought up to date */
};

extern const uint16_t led_longest[LED_CHANNELS];

/* At least once in 17 minutes. */
void budget_fill(struct budget *budget, ticks_t now);
/* Channel that has not cooled down for this pulse, or CHANNEL_NONE: then the light is taken out. */
uint8_t budget_take(struct budget *budget, ticks_t now, const struct step *step);
/* Channel for which the pulse itself is too long (or too short, or does not exist), or CHANNEL_NONE. */
uint8_t step_refused(const struct step *step);

#endif
