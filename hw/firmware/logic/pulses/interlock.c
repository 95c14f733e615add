#include "interlock.h"

#include "controller.h"
#include "hardware.h"

/* Each condition by itself must hold the board back. The order only decides which reason is reported. */
static uint8_t why_hold(const struct controller *c, ticks_t now)
{
    const struct interlock *i = &c->interlock;
    if (!i->lasting) return HOLD_HOST;
    if (i->permit == PERMIT_TEST) return c->state == STATE_IDLE ? HOLD_NONE : HOLD_STATE;
    if (c->state != STATE_ARMED) return HOLD_STATE;
    if (c->barrier.raw || c->barrier.confirmed) return HOLD_BARRIER;
    if (i->opened) return HOLD_GAP;
    if (c->clear_known && now - c->last_clear < c->configuration.active.timing.min_gap) return HOLD_GAP;
    return i->permit == i->spent ? HOLD_SPENT : HOLD_NONE;
}

struct refusal interlock_state(struct controller *c, const struct ready_request *request, ticks_t now)
{
    struct interlock *i = &c->interlock;
    if (request->hold_ms > READY_LONGEST_MS) return (struct refusal){NAK_RANGE, 0, READY_LONGEST_MS};
    /* A test belongs to bring-up: armed, it would let a board in that nothing permits. */
    if (request->hold_ms && request->permit == PERMIT_TEST && c->state != STATE_IDLE) return (struct refusal){NAK_STATE, 0, c->state};
    /* A withdrawal is obeyed whatever its number, and does not make a permit that was used up another one. */
    if (request->hold_ms) i->permit = request->permit;
    i->since = now;
    i->lasting = MS((uint32_t)request->hold_ms);
    /* The host permits the next board after it has seen the end of this one: what comes earlier does not know of it. */
    if (c->state == STATE_RUNNING) interlock_spend(c);
    interlock_poll(c, now);
    return (struct refusal){NAK_NONE, 0, 0};
}

void interlock_spend(struct controller *c) { c->interlock.spent = c->interlock.permit; }

void interlock_drop(struct controller *c, ticks_t now)
{
    struct interlock *i = &c->interlock;
    if (i->high) {
        i->fell = now;
        i->opened = 1;
    }
    i->high = ready_output(0);
}

void interlock_poll(struct controller *c, ticks_t now)
{
    struct interlock *i = &c->interlock;
    if (now - i->since >= i->lasting) i->lasting = 0;
    if (now - i->fell >= READY_PAUSE) i->opened = 0;
    i->hold = why_hold(c, now);
    /* Set again on every call: an edge of the barrier lowers the output before the logic receives the edge. */
    if (i->hold != HOLD_NONE || !ready_output(1)) interlock_drop(c, now);
    else i->high = 1;
}
