#include "config.h"

#include "checksum.h"

enum field { PACING, STEPS, MAX_ROWS, START_DELAY, PERIOD, TAIL, MIN_PERIOD, DEBOUNCE, MIN_GAP, TRIGGER_WIDTH, STEP_0 = 16, WIDTH_0 = 32 };

static const struct refusal FINE = {NAK_NONE, 0, 0};

uint32_t config_crc(const struct config *c)
{
    uint32_t crc = crc32_of(0, &c->timing, sizeof c->timing);
    crc = crc32_of(crc, c->steps, (uint8_t)(c->timing.steps * sizeof *c->steps));
    for (uint8_t k = 0; k < c->timing.steps; k++)
        if (config_own_width(c, k)) return crc32_of(crc, c->widths, (uint8_t)(c->timing.steps * sizeof *c->widths));
    return crc;
}

void config_set_timing(struct config *c, const struct timing *timing)
{
    c->timing = *timing;
    for (uint8_t k = 0; k < PROGRAM_STEPS; k++) c->widths[k] = timing->trigger_width;
}

uint16_t config_own_width(const struct config *c, uint8_t step)
{
    return c->widths[step] == c->timing.trigger_width ? 0 : c->widths[step];
}

static struct refusal within(uint8_t field, uint32_t value, uint32_t least, uint32_t most)
{
    if (value < least) return (struct refusal){NAK_RANGE, field, least};
    if (value > most) return (struct refusal){NAK_RANGE, field, most};
    return FINE;
}

#define REQUIRE(check) do { struct refusal r = (check); if (r.reason) return r; } while (0)

static struct refusal check_timing(const struct timing *t)
{
    uint8_t by_distance = t->pacing == PACING_DISTANCE;
    uint32_t confirmed = t->debounce + DECISION;
    REQUIRE(within(PACING, t->pacing, PACING_TIME, PACING_DISTANCE));
    REQUIRE(within(STEPS, t->steps, 1, PROGRAM_STEPS));
    REQUIRE(within(MAX_ROWS, t->max_rows, 1, ROW_NONE - 1));
    REQUIRE(within(DEBOUNCE, t->debounce, 0, MS(1000)));
    REQUIRE(within(MIN_GAP, t->min_gap, 0, TIME_LONGEST));
    REQUIRE(within(MIN_PERIOD, t->min_period, PERIOD_SHORTEST, TIME_LONGEST));
    REQUIRE(within(TRIGGER_WIDTH, t->trigger_width, TRIGGER_SHORTEST, TRIGGER_LONGEST));
    /* Encoder counts cannot be compared with ticks; rows that come too early are then suppressed one by one. */
    REQUIRE(within(START_DELAY, t->start_delay, by_distance ? 0 : confirmed, TIME_LONGEST));
    REQUIRE(within(PERIOD, t->period, by_distance ? 1 : t->min_period, TIME_LONGEST));
    return within(TAIL, t->tail, by_distance ? 0 : confirmed, TIME_LONGEST);
}

/* Every step must be allowed at the shortest period, so that a running program never exhausts the LED budget. */
static struct refusal check_step(const struct step *step, uint8_t k, uint32_t min_period)
{
    uint8_t channel = step_refused(step);
    if (channel != CHANNEL_NONE)
        return (struct refusal){NAK_LED_LIMIT, STEP_0 + k, channel < LED_CHANNELS ? led_longest[channel] : LED_CHANNELS};
    if (step->width > min_period >> LED_DUTY_SHIFT)
        return (struct refusal){NAK_LED_LIMIT, STEP_0 + k, min_period >> LED_DUTY_SHIFT};
    return FINE;
}

/* The trigger must have fallen before the next row is prepared. */
static struct refusal check_width(const struct config *c, uint8_t k, uint32_t shortest)
{
    if (!config_own_width(c, k)) return FINE;
    uint32_t most = shortest - TRIGGER_CLEARANCE;
    return within(WIDTH_0 + k, c->widths[k], TRIGGER_SHORTEST, most < STEP_TRIGGER_LONGEST ? most : STEP_TRIGGER_LONGEST);
}

struct refusal config_check(const struct config *c)
{
    REQUIRE(check_timing(&c->timing));
    uint32_t shortest = c->timing.pacing == PACING_TIME ? c->timing.period : c->timing.min_period;
    for (uint8_t k = 0; k < c->timing.steps; k++) {
        REQUIRE(check_step(&c->steps[k], k, shortest));
        REQUIRE(check_width(c, k, shortest));
    }
    return FINE;
}

struct refusal config_commit(struct configuration *c, uint32_t crc)
{
    REQUIRE(config_check(&c->staged));
    uint32_t right = config_crc(&c->staged);
    if (crc != right) return (struct refusal){NAK_CHECKSUM, 0, right};
    c->active = c->staged;
    c->crc = crc;
    return FINE;
}
