#include "budget.h"

const uint16_t led_longest[LED_CHANNELS] = LED_LONGEST;

void budget_fill(struct budget *b, ticks_t now)
{
    ticks_t light = (now - b->filled) >> LED_DUTY_SHIFT;
    b->filled += light << LED_DUTY_SHIFT; /* the remainder of the shift counts next time, so no light is lost or gained */
    for (uint8_t k = 0; k < LED_CHANNELS; k++)
        b->left[k] = light >= (ticks_t)(LED_BUCKET - b->left[k]) ? LED_BUCKET : (uint16_t)(b->left[k] + light);
}

uint8_t budget_take(struct budget *b, ticks_t now, const struct step *step)
{
    budget_fill(b, now);
    /* All channels are checked before any is charged: a refused pulse costs nothing. */
    for (uint8_t k = 0; k < LED_CHANNELS; k++)
        if (step->channels >> k & 1 && b->left[k] < step->width) return k;
    for (uint8_t k = 0; k < LED_CHANNELS; k++)
        if (step->channels >> k & 1) b->left[k] -= step->width;
    return CHANNEL_NONE;
}

uint8_t step_refused(const struct step *step)
{
    if (step->channels >> LED_CHANNELS) return LED_CHANNELS;
    if (!step->channels) return step->width ? 0 : CHANNEL_NONE;
    for (uint8_t k = 0; k < LED_CHANNELS; k++)
        if (step->channels >> k & 1 && (step->width > led_longest[k] || step->width < LED_SHORTEST)) return k;
    return CHANNEL_NONE;
}
