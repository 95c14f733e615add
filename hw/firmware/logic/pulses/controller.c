#include "controller.h"

#include <string.h>

#include "hardware.h"

static const struct timing *timing(const struct controller *c) { return &c->configuration.active.timing; }
static uint8_t by_distance(const struct controller *c) { return timing(c)->pacing == PACING_DISTANCE; }

static void report(struct controller *c, ticks_t tick, uint8_t kind, uint8_t detail, uint16_t index, uint32_t value)
{
    event_add(&c->events, tick, kind, detail, index, value);
}

/* Reports the pulse once its edge has risen, even if it has not ended: the cameras were triggered. */
static void report_pulse(struct controller *c)
{
    c->pulse.under_way = 0;
    report(c, c->pulse.due, EVENT_PULSE, c->pulse.light.channels, c->pulse.row,
           PULSE_VALUE(c->pulse.light.width, c->pulse.own_width));
    if (c->pulse.row != ROW_NONE) c->passage.fired++;
}

/* Cancels the pulse if it has not risen; reports it if it has. */
static void settle_pulse(struct controller *c)
{
    if (!c->pulse.under_way) return;
    if (pulse_cancel()) c->pulse.under_way = 0;
    else report_pulse(c);
}

static void end_run(struct controller *c, uint8_t why, ticks_t now)
{
    settle_pulse(c);
    report(c, now, EVENT_RUN_END, why, c->passage.fired, c->passage.suppressed);
    c->state = STATE_ARMED;
}

/* Sums of integers: no rounding error adds up over a run. */
static void next_row(struct controller *c)
{
    c->passage.row++;
    if (by_distance(c)) {
        c->passage.place += (int32_t)timing(c)->period;
        encoder_watch(c->passage.place);
    } else {
        c->passage.due += timing(c)->period;
    }
}

static void suppress(struct controller *c, ticks_t due, uint8_t why, uint32_t value)
{
    report(c, due, EVENT_SUPPRESSED, why, c->passage.row, value);
    c->passage.suppressed++;
    next_row(c);
}

static void start_run(struct controller *c, const struct edge *edge)
{
    memset(&c->passage, 0, sizeof c->passage);
    c->state = STATE_RUNNING;
    c->passage.due = edge->tick + timing(c)->start_delay;
    c->passage.place = edge->position + (int32_t)timing(c)->start_delay;
    if (by_distance(c)) encoder_watch(c->passage.place);
}

static void on_board_arrival(struct controller *c, const struct edge *edge)
{
    if (c->state == STATE_RUNNING) { /* a cut-out, or another board: the same run continues, the host decides */
        c->passage.left = 0;
        report(c, edge->tick, EVENT_EDGE, 1, c->run, (uint32_t)edge->position);
        return;
    }
    if (c->state != STATE_ARMED) return;
    interlock_spend(c);
    /* Without a board since the reset there is no gap to measure. */
    uint32_t gap = edge->tick - c->last_clear;
    if (c->clear_known && gap < timing(c)->min_gap) {
        report(c, edge->tick, EVENT_SUPPRESSED, SUPPRESSED_GAP, ROW_NONE, gap);
        return;
    }
    report(c, edge->tick, EVENT_BARRIER, 1, c->run, (uint32_t)edge->position);
    start_run(c, edge);
}

static void on_board_departure(struct controller *c, const struct edge *edge)
{
    c->last_clear = edge->tick;
    c->clear_known = 1;
    if (c->state == STATE_ARMED) /* what leaves was refused, stood here before, or outlasted its run */
        report(c, edge->tick, EVENT_EDGE, 0, c->run, (uint32_t)edge->position);
    if (c->state != STATE_RUNNING) return;
    c->passage.left = 1;
    c->passage.clear = *edge;
    report(c, edge->tick, EVENT_BARRIER, 0, c->run, (uint32_t)edge->position);
}

/* The counter wraps after 35.8 min. A departure is forgotten long before, or it would look recent again. */
static void forget_departure(struct controller *c, ticks_t now)
{
    if (c->clear_known && now - c->last_clear > TIME_LONGEST && ticks_since(now, c->last_clear) > 0) c->clear_known = 0;
}

static void watch_barrier(struct controller *c, ticks_t now)
{
    if (!barrier_poll(&c->barrier, now, timing(c)->debounce)) return;
    if (c->barrier.confirmed) on_board_arrival(c, &c->barrier.edge);
    else on_board_departure(c, &c->barrier.edge);
}

void controller_edge(struct controller *c, const struct edge *edge)
{
    if (edge->blocked) interlock_drop(c, edge->tick);
    watch_barrier(c, edge->tick); /* first confirm the edge before, which may have lasted long enough by now */
    ticks_t began = c->barrier.edge.tick;
    uint32_t bounce = barrier_edge(&c->barrier, edge);
    if (bounce && (c->state == STATE_ARMED || c->state == STATE_RUNNING))
        report(c, began, EVENT_SUPPRESSED, SUPPRESSED_BOUNCE, ROW_NONE, bounce);
}

static uint8_t run_is_over(const struct controller *c)
{
    const struct passage *p = &c->passage;
    if (p->left) { /* first: a board that needed exactly max_rows has left */
        int32_t beyond = by_distance(c) ? p->place - p->clear.position - (int32_t)timing(c)->tail
                                        : ticks_since(p->due, p->clear.tick + timing(c)->tail);
        if (beyond > 0) return END_CLEAR;
    }
    return p->row >= timing(c)->max_rows ? END_MAX_ROWS : 0;
}

static uint8_t start_pulse(struct controller *c, ticks_t due, uint16_t trigger_width, const struct step *light, uint16_t row)
{
    if (!pulse_start(due, trigger_width, light)) return 0;
    c->pulse = (struct pulse_under_way){1, row, due, *light, 0};
    return 1;
}

static void prepare_row(struct controller *c, ticks_t due, ticks_t now)
{
    struct passage *p = &c->passage;
    const uint8_t step = (uint8_t)(p->row % timing(c)->steps);
    const struct step *light = &c->configuration.active.steps[step];
    if (ticks_since(due, now) < (int32_t)TOO_LATE) {
        suppress(c, due, SUPPRESSED_LATE, 0);
        return;
    }
    uint8_t hot_channel = budget_take(&c->budget, now, light);
    if (hot_channel != CHANNEL_NONE) suppress(c, due, SUPPRESSED_LED_BUDGET, hot_channel);
    else if (!start_pulse(c, due, c->configuration.active.widths[step], light, p->row)) suppress(c, due, SUPPRESSED_LATE, 0);
    else {
        c->pulse.own_width = config_own_width(&c->configuration.active, step);
        p->last_due = due;
        next_row(c);
    }
}

static void pace_by_distance(struct controller *c, ticks_t now)
{
    ticks_t reached;
    if (!encoder_reached(&reached)) return;
    ticks_t due = reached + ENCODER_LATENCY;
    uint32_t interval = due - c->passage.last_due;
    if (c->passage.fired && interval < timing(c)->min_period) suppress(c, due, SUPPRESSED_TOO_FAST, interval);
    else prepare_row(c, due, now);
}

static void continue_run(struct controller *c, ticks_t now)
{
    uint8_t over = run_is_over(c);
    if (over) end_run(c, over, now);
    else if (by_distance(c)) pace_by_distance(c, now);
    else if (ticks_since(c->passage.due, now) <= (int32_t)PREPARE) prepare_row(c, c->passage.due, now);
}

static void watch_pulse(struct controller *c, ticks_t now)
{
    uint8_t pulse = pulse_poll();
    if (pulse == PULSE_CUT) controller_safe(c, FAULT_GUARD, now);
    else if (pulse == PULSE_DONE && c->pulse.under_way) report_pulse(c);
}

void controller_poll(struct controller *c, ticks_t now)
{
    budget_fill(&c->budget, now);
    /* The barrier before the rows: a board that has left may end the run and cancel its next row. */
    watch_pulse(c, now);
    forget_departure(c, now);
    watch_barrier(c, now);
    uint8_t needs_host = c->state == STATE_ARMED || c->state == STATE_RUNNING;
    if (needs_host && ticks_since(now, c->last_beat) > (int32_t)HEARTBEAT) controller_safe(c, FAULT_HEARTBEAT, now);
    if (c->state == STATE_RUNNING && !c->pulse.under_way) continue_run(c, now);
    interlock_poll(c, now);
    contacts_poll(c, now);
}

void controller_start(struct controller *c, ticks_t now, uint8_t blocked, uint32_t boots, uint8_t reset_cause)
{
    memset(c, 0, sizeof *c);
    c->boots = boots;
    c->reset_cause = reset_cause;
    c->budget.filled = now;
    c->barrier.raw = c->barrier.confirmed = blocked;
    report(c, now, EVENT_BOOT, reset_cause, 0, boots);
}

void controller_arm(struct controller *c, uint16_t run, ticks_t now)
{
    c->run = run;
    c->last_beat = now;
    c->interlock.lasting = 0; /* what was stated before belongs to another arming */
    c->state = STATE_ARMED;
}

void controller_disarm(struct controller *c, ticks_t now)
{
    if (c->state == STATE_RUNNING) end_run(c, END_DISARMED, now);
    c->state = STATE_IDLE;
    c->fault = FAULT_NONE;
}

void controller_safe(struct controller *c, uint8_t fault, ticks_t now)
{
    if (c->state == STATE_RUNNING) end_run(c, END_SAFE, now);
    settle_pulse(c); /* before the outputs are off, so that a risen pulse is still reported */
    outputs_off();
    if (c->state != STATE_SAFE) report(c, now, EVENT_FAULT, fault, 0, 0);
    c->state = STATE_SAFE;
    c->fault = fault;
}

struct refusal controller_fire(struct controller *c, const struct fire_request *request, ticks_t now)
{
    /* A repeated request whose reply was lost: succeed without a second pulse. */
    if (c->fired_once && c->fire_nonce == request->nonce) return (struct refusal){NAK_NONE, 0, 0};
    if (c->state == STATE_RUNNING || c->state == STATE_SAFE || c->pulse.under_way)
        return (struct refusal){NAK_STATE, 0, c->state};
    uint8_t channel = step_refused(&request->step);
    if (channel != CHANNEL_NONE)
        return (struct refusal){NAK_LED_LIMIT, channel, channel < LED_CHANNELS ? led_longest[channel] : LED_CHANNELS};
    if (request->trigger_width < TRIGGER_SHORTEST) return (struct refusal){NAK_RANGE, 0, TRIGGER_SHORTEST};
    if (request->trigger_width > STEP_TRIGGER_LONGEST) return (struct refusal){NAK_RANGE, 0, STEP_TRIGGER_LONGEST};
    channel = budget_take(&c->budget, now, &request->step);
    if (channel != CHANNEL_NONE) return (struct refusal){NAK_LED_BUDGET, channel, 0};
    if (!start_pulse(c, now + PREPARE, request->trigger_width, &request->step, ROW_NONE))
        return (struct refusal){NAK_STATE, 0, c->state};
    c->fired_once = 1;
    c->fire_nonce = request->nonce;
    return (struct refusal){NAK_NONE, 0, 0};
}
