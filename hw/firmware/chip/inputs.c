#include "inputs.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"
#include "hardware.h"
#include "timebase.h"

#define EDGES 8 /* a power of two */

static struct edge edges[EDGES];
static volatile uint8_t edges_in, edges_out, edges_lost;
static uint8_t level; /* after the last edge that was handled */

static volatile int32_t position;
static int32_t watched;
static ticks_t reached_at;
static volatile uint8_t watching, reached;
static uint8_t phase; /* last state of the encoder's B and A */

static void store_edge(ticks_t tick)
{
    if ((uint8_t)(edges_in - edges_out) == EDGES) {
        edges_lost++;
        return;
    }
    edges[edges_in % EDGES] = (struct edge){tick, position, level};
    edges_in++;
}

static void select_next_edge(void)
{
    if (level) TCCR1B &= (uint8_t)~(1 << ICES1);
    else TCCR1B |= 1 << ICES1;
}

/* Changing the edge select may itself set the capture flag, and an edge may occur during the change (ATmega328P data
 * sheet, Input Capture Unit). So the level decides: an interrupt without a change is ignored, and a change that is already
 * there is stored without an interrupt. */
ISR(TIMER1_CAPT_vect)
{
    uint16_t captured = ICR1;
    uint8_t now = (PINB & BARRIER_PIN) != 0;
    if (now != level) {
        level = now;
        if (level) PORTC &= (uint8_t)~LINE_READY_PIN; /* first of all: the next board must wait */
        select_next_edge();
        store_edge(timebase_extend(captured));
    }
    now = (PINB & BARRIER_PIN) != 0;
    if (now != level) {
        level = now;
        if (level) PORTC &= (uint8_t)~LINE_READY_PIN;
        select_next_edge();
        store_edge(timebase_extend(TCNT1));
    }
}

/* Both channels, both edges. The table is indexed by old and new phase: +1, -1, or 0 if nothing or too much has changed.
 * Inlined into both interrupts, because a call would make them save every register. */
static inline __attribute__((always_inline)) void encoder_step(void)
{
    static const int8_t STEP[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
    uint8_t seen = (uint8_t)((PIND & (ENCODER_A | ENCODER_B)) >> PD2);
    position += STEP[phase << 2 | seen];
    phase = seen;
    if (watching && position - watched >= 0) {
        watching = 0;
        reached = 1;
        reached_at = timebase_extend(TCNT1);
    }
}

ISR(INT0_vect) { encoder_step(); }
ISR(INT1_vect) { encoder_step(); }

void inputs_start(void)
{
    level = (PINB & BARRIER_PIN) != 0;
    select_next_edge();
    phase = (uint8_t)((PIND & (ENCODER_A | ENCODER_B)) >> PD2);
    TIMSK1 |= 1 << ICIE1;
    EICRA = (1 << ISC00) | (1 << ISC10); /* any change */
    EIMSK = (1 << INT0) | (1 << INT1);
}

uint8_t barrier_level(void) { return (PINB & BARRIER_PIN) != 0; }

uint8_t contacts_read(void)
{
    const uint8_t open = PINC;
    return (open & AVAILABLE_IN_PIN ? 0 : CONTACT_AVAILABLE) | (open & FAILED_IN_PIN ? 0 : CONTACT_FAILED) |
           (open & NEXT_READY_PIN ? 0 : CONTACT_NEXT_READY);
}

uint8_t take_edge(struct edge *edge)
{
    if (edges_in == edges_out) return 0;
    *edge = edges[edges_out % EDGES];
    edges_out++;
    return 1;
}

uint8_t take_edges_lost(void)
{
    uint8_t lost;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        lost = edges_lost;
        edges_lost = 0;
    }
    return lost;
}

int32_t encoder_position(void)
{
    int32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = position;
    return now;
}

void encoder_watch(int32_t place)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        watched = place;
        reached = position - place >= 0;
        watching = !reached;
        reached_at = timebase_extend(TCNT1);
    }
}

uint8_t encoder_reached(ticks_t *when)
{
    uint8_t was_reached;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        was_reached = reached;
        *when = reached_at;
        reached = 0;
    }
    return was_reached;
}
