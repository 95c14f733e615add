/* The compare units make the edges, so that interrupt latency does not move them: "set on match" is selected while the
 * pin is low, "clear on match" while it is high, and after the falling edge the pin returns to the port, which holds
 * zero. In this order simavr 1.6 and 1.7, which treat compare outputs as in PWM modes, behave like the chip.
 *
 * The compare interrupts are always enabled and check whether their time has come. So no flag must be cleared by hand:
 * simavr drops all flags of a timer when one is cleared.
 */
#include "outputs.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"
#include "hardware.h"
#include "timebase.h"

#define A_SET ((1 << COM1A1) | (1 << COM1A0))
#define A_CLEAR (1 << COM1A1)
#define B_SET ((1 << COM1B1) | (1 << COM1B0))
#define B_CLEAR (1 << COM1B1)

/* The output changes one count after the match. */
#define MATCH_AT(count) ((uint16_t)((count) - 1))
/* A nearer match could pass while it is being written. */
#define NEAREST US(20)

enum phase { LOW, RISING, HIGH };

static volatile uint8_t trigger_phase, gate_phase;
static volatile uint8_t waiting;     /* a pulse was started and its end not yet returned */
static volatile uint8_t cut;         /* the guard ended the pulse */
static volatile uint8_t guard_left;  /* periods of Timer 2 until the guard switches all off */
static volatile uint8_t guard_count;
static uint16_t trigger_width, gate_width;

static uint8_t is_past(uint16_t match) { return (int16_t)(TCNT1 - match) > 0; }

static void all_low(void)
{
    TCCR1A = 0;
    PORTB &= (uint8_t)~(TRIGGER_PIN | GATE_PIN);
    PORTD &= (uint8_t)~CHANNEL_PINS;
    PORTC &= (uint8_t)~LINE_READY_PIN;
    trigger_phase = gate_phase = LOW;
    guard_left = 0;
}

static inline void end_gate(void)
{
    TCCR1A &= (uint8_t)~B_SET;
    PORTD &= (uint8_t)~CHANNEL_PINS;
    gate_phase = LOW;
    guard_left = 0;
}

static inline void step_gate(void)
{
    if (gate_phase == LOW || !is_past(OCR1B)) return;
    if (gate_phase == HIGH) {
        end_gate();
        return;
    }
    TCCR1A = (TCCR1A & (uint8_t)~B_SET) | B_CLEAR;
    OCR1B += gate_width;
    gate_phase = HIGH;
    if (is_past(OCR1B)) { /* so late that the match may have been missed: end the light here */
        end_gate();
        PORTB &= (uint8_t)~GATE_PIN;
    }
}

static inline void step_trigger(void)
{
    if (trigger_phase == LOW || !is_past(OCR1A)) return;
    if (trigger_phase == RISING) {
        TCCR1A = (TCCR1A & (uint8_t)~A_SET) | A_CLEAR;
        OCR1A += trigger_width;
        trigger_phase = HIGH;
        if (!is_past(OCR1A)) return;
        PORTB &= (uint8_t)~TRIGGER_PIN;
    }
    TCCR1A &= (uint8_t)~A_SET;
    trigger_phase = LOW;
}

/* Both outputs rise together. Whichever interrupt runs first handles the gate first, because LEDs can be damaged. */
ISR(TIMER1_COMPA_vect)
{
    step_gate();
    step_trigger();
}

ISR(TIMER1_COMPB_vect)
{
    step_gate();
    step_trigger();
}

/* The guard runs on a separate timer with a count set before the pulse: it depends on nothing that it guards. */
ISR(TIMER2_COMPA_vect)
{
    guard_count++;
    if (guard_left && --guard_left == 0) {
        all_low();
        cut = 1;
    }
}

void outputs_start(void)
{
    all_low(); /* low before they are outputs */
    DDRB |= TRIGGER_PIN | GATE_PIN;
    DDRD |= CHANNEL_PINS;
    DDRC |= LINE_READY_PIN | AVAILABLE_OUT_PIN | FAILED_OUT_PIN;
    TIMSK1 |= (1 << OCIE1A) | (1 << OCIE1B);
    OCR2A = F_CPU / 1000000UL * GUARD_TICK_US / 64 - 1;
    TCCR2A = 1 << WGM21; /* CTC mode: from 0 to OCR2A */
    TIMSK2 = 1 << OCIE2A;
    TCCR2B = 1 << CS22; /* clk/64 */
}

uint8_t ready_output(uint8_t high)
{
    uint8_t level = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        /* The edge of a board that comes now may not have reached the logic yet. */
        if (high && !(PINB & BARRIER_PIN)) {
            PORTC |= LINE_READY_PIN;
            level = 1;
        } else {
            PORTC &= (uint8_t)~LINE_READY_PIN;
        }
    }
    return level;
}

/* Each pin by an instruction of its own, which no interrupt divides. */
void contacts_output(uint8_t closed)
{
    if (closed & CONTACT_OFFERED) PORTC |= AVAILABLE_OUT_PIN;
    else PORTC &= (uint8_t)~AVAILABLE_OUT_PIN;
    if (closed & CONTACT_OFFERED_FAILED) PORTC |= FAILED_OUT_PIN;
    else PORTC &= (uint8_t)~FAILED_OUT_PIN;
}

uint8_t guard_ticks(void) { return guard_count; }

uint8_t pulse_start(ticks_t due, uint16_t trigger, const struct step *light)
{
    uint8_t taken = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        uint16_t ahead = (uint16_t)((uint16_t)due - TCNT1);
        if (!waiting && ahead >= NEAREST && ahead < 0x4000) {
            trigger_width = trigger;
            gate_width = light->width;
            OCR1A = OCR1B = MATCH_AT((uint16_t)due);
            TCCR1A = light->channels ? A_SET | B_SET : A_SET;
            trigger_phase = RISING;
            waiting = 1;
            cut = 0;
            if (light->channels) {
                gate_phase = RISING;
                PORTD = (PORTD & (uint8_t)~CHANNEL_PINS) | (uint8_t)(light->channels << CHANNEL_SHIFT);
                /* Time until the gate falls, rounded up, plus one for the phase of Timer 2, and one because its interrupt
                 * has priority over the one that ends the light. The guard fires 64 to 192 us after the end. */
                guard_left = (uint8_t)((ahead + light->width) / US(GUARD_TICK_US) + 3);
            }
            taken = 1;
        }
    }
    return taken;
}

uint8_t pulse_poll(void)
{
    uint8_t pulse = PULSE_NONE;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (cut) pulse = PULSE_CUT;
        else if (trigger_phase == RISING) pulse = PULSE_WAITING;
        else if (trigger_phase != LOW || gate_phase != LOW) pulse = PULSE_HIGH;
        else if (waiting) pulse = PULSE_DONE;
        if (pulse == PULSE_CUT || pulse == PULSE_DONE) cut = waiting = 0;
    }
    return pulse;
}

uint8_t pulse_cancel(void)
{
    uint8_t cancelled = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (trigger_phase == RISING && !is_past(OCR1A)) {
            all_low();
            waiting = 0;
            cancelled = 1;
        }
    }
    return cancelled;
}

void outputs_off(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        all_low();
        waiting = cut = 0;
    }
}
