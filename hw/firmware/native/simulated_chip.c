#include "simulated_chip.h"

#include <stddef.h>
#include <string.h>

/* Light is counted in sixteenths of ticks, so that the duty limit needs no division. */
#define SCALE (1 << LED_DUTY_SHIFT)

static struct {
    ticks_t now;
    uint8_t waiting, unreported;
    ticks_t due;
    uint16_t trigger_width;
    struct step light;
    int32_t position, watched;
    uint8_t watching, reached;
    ticks_t reached_at;
    uint32_t pulses;
    uint8_t ready;
    uint8_t neighbours, offered;    /* contacts: inputs and outputs that are closed */
    uint64_t time;                  /* ticks since the reset, without wrapping */
    int64_t lit[LED_CHANNELS];      /* light minus allowance, scaled */
    int64_t lowest[LED_CHANNELS];   /* minimum of that since the reset */
    const char *violation;
} chip;

static const uint16_t longest[LED_CHANNELS] = LED_LONGEST;

void chip_reset(ticks_t now)
{
    memset(&chip, 0, sizeof chip);
    chip.now = now;
}

/* Checks that in any interval a channel gives at most the light of its bucket plus the duty limit of the interval. */
static void book_light(void)
{
    const struct step *light = &chip.light;
    if (light->channels >> LED_CHANNELS) chip.violation = "a channel that does not exist";
    for (uint8_t k = 0; k < LED_CHANNELS; k++) {
        if (!(light->channels >> k & 1)) continue;
        if (light->width > longest[k]) chip.violation = "a pulse longer than the channel bears";
        int64_t before = chip.lit[k] - (int64_t)chip.time;
        if (before < chip.lowest[k]) chip.lowest[k] = before;
        chip.lit[k] += (int64_t)light->width * SCALE;
        /* A row is taken from the bucket up to PREPARE before it is lit, and the bucket fills in whole ticks. */
        if (before + (int64_t)light->width * SCALE - chip.lowest[k] > ((int64_t)LED_BUCKET + SCALE) * SCALE + (int64_t)PREPARE)
            chip.violation = "more light than the duty cycle allows";
    }
    chip.pulses++;
}

void chip_advance(ticks_t now)
{
    if (chip.waiting && ticks_since(now, chip.due) >= 0) {
        chip.time += chip.due - chip.now;
        chip.now = chip.due;
        chip.waiting = 0;
        book_light();
    }
    chip.time += now - chip.now;
    chip.now = now;
}

void chip_set_encoder(int32_t position)
{
    chip.position = position;
    if (chip.watching && position - chip.watched >= 0) {
        chip.watching = 0;
        chip.reached = 1;
        chip.reached_at = chip.now;
    }
}

uint32_t chip_pulses(void)
{
    uint32_t pulses = chip.pulses;
    chip.pulses = 0;
    return pulses;
}

const char *chip_violation(void) { return chip.violation; }

uint8_t pulse_start(ticks_t due, uint16_t trigger_width, const struct step *light)
{
    if (chip.waiting || chip.unreported || ticks_since(due, chip.now) < (int32_t)US(20)) return 0;
    chip.waiting = chip.unreported = 1;
    chip.due = due;
    chip.trigger_width = trigger_width;
    chip.light = *light;
    return 1;
}

uint8_t pulse_poll(void)
{
    if (!chip.unreported) return PULSE_NONE;
    if (chip.waiting) return PULSE_WAITING;
    uint16_t width = chip.light.width > chip.trigger_width ? chip.light.width : chip.trigger_width;
    if (ticks_since(chip.now, chip.due) < width) return PULSE_HIGH;
    chip.unreported = 0;
    return PULSE_DONE;
}

uint8_t pulse_cancel(void)
{
    if (!chip.waiting) return 0;
    chip.waiting = chip.unreported = 0;
    return 1;
}

void outputs_off(void) { chip.waiting = chip.unreported = chip.ready = 0; }

uint8_t ready_output(uint8_t high) { return chip.ready = high; }

uint8_t chip_ready(void) { return chip.ready; }

uint8_t contacts_read(void) { return chip.neighbours; }

void contacts_output(uint8_t closed) { chip.offered = closed & (CONTACT_OFFERED | CONTACT_OFFERED_FAILED); }

void chip_close(uint8_t contacts) { chip.neighbours = contacts; }

uint8_t chip_offered(void) { return chip.offered; }

int32_t encoder_position(void) { return chip.position; }

void encoder_watch(int32_t place)
{
    chip.watched = place;
    chip.reached = chip.position - place >= 0;
    chip.watching = !chip.reached;
    chip.reached_at = chip.now;
}

uint8_t encoder_reached(ticks_t *when)
{
    uint8_t reached = chip.reached;
    *when = chip.reached_at;
    chip.reached = 0;
    return reached;
}
