/* From the barrier to the pulses: when a row is due, what ends a run, what is reported. Without registers. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "barrier.h"
#include "config.h"
#include "contacts.h"
#include "events.h"
#include "interlock.h"

struct passage {
    uint16_t row;       /* the next one */
    uint16_t fired, suppressed;
    uint8_t left;       /* the board has left, at `clear` */
    struct edge clear;
    ticks_t due;        /* of the next row, paced by time */
    int32_t place;      /* of the next row, paced by distance */
    ticks_t last_due;   /* of the last pulse, if fired */
};

struct pulse_under_way {
    uint8_t under_way;
    uint16_t row;
    ticks_t due;
    struct step light;
    uint16_t own_width; /* of the trigger, if the row's step has one of its own, else 0 */
};

struct controller {
    uint8_t state, fault, reset_cause;
    uint16_t run;
    uint32_t boots, unit;
    struct configuration configuration;
    struct budget budget;
    struct barrier barrier;
    struct passage passage;
    struct pulse_under_way pulse;
    struct events events;
    struct interlock interlock;
    struct contacts contacts;
    ticks_t last_beat;   /* time of the last heartbeat of the host */
    ticks_t last_clear;  /* when the last board left; valid if clear_known */
    uint8_t clear_known;
    uint8_t fired_once;  /* fire_nonce is valid */
    uint16_t fire_nonce;
    uint16_t unknown, replies_lost, bytes_lost, edges_lost;
};

void controller_start(struct controller *c, ticks_t now, uint8_t blocked, uint32_t boots, uint8_t reset_cause);
void controller_edge(struct controller *c, const struct edge *edge);
/* To be called as often as possible: rows are suppressed if more than PREPARE passes between two calls. */
void controller_poll(struct controller *c, ticks_t now);

void controller_arm(struct controller *c, uint16_t run, ticks_t now);
void controller_disarm(struct controller *c, ticks_t now);
void controller_safe(struct controller *c, uint8_t fault, ticks_t now);
/* Fires one pulse without a row; returns NAK_NONE or the refusal. */
struct refusal controller_fire(struct controller *c, const struct fire_request *request, ticks_t now);

#endif
