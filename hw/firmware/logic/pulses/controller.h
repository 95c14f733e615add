/* The rules from barrier to pulse: when a row is due, what stops a run, what is reported. No registers here. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "barrier.h"
#include "config.h"
#include "events.h"

struct passage {
    uint16_t row;       /* the next one */
    uint16_t fired, suppressed;
    uint8_t left;       /* the board has left; since: */
    struct edge clear;
    ticks_t due;        /* of the next row, paced by time */
    int32_t place;      /* of the next row, paced by distance */
    ticks_t last_due;   /* of the last pulse, if fired */
};

struct shot { uint8_t under_way; uint16_t row; ticks_t due; struct step light; };

struct controller {
    uint8_t state, fault, reset_cause;
    uint16_t run;
    uint32_t boots, unit;
    struct configuration configuration;
    struct budget budget;
    struct barrier barrier;
    struct passage passage;
    struct shot shot;
    struct events events;
    ticks_t beat;        /* when the host was last heard */
    ticks_t last_clear;  /* when the last board left, if any since the reset */
    uint8_t clear_known;
    uint8_t fired_once;  /* fire_nonce is one */
    uint16_t fire_nonce;
    uint16_t unknown, replies_lost, bytes_lost, edges_lost;
};

void controller_start(struct controller *c, ticks_t now, uint8_t blocked, uint32_t boots, uint8_t reset_cause);
void controller_edge(struct controller *c, const struct edge *edge);
/* As often as possible; a row is late if more than PREPARE passes between two calls. */
void controller_poll(struct controller *c, ticks_t now);

void controller_arm(struct controller *c, uint16_t run, ticks_t now);
void controller_disarm(struct controller *c, ticks_t now);
void controller_safe(struct controller *c, uint8_t fault, ticks_t now);
/* One pulse that belongs to no row. NAK_NONE, or why not. */
struct refusal controller_fire(struct controller *c, const struct fire_request *request, ticks_t now);

#endif
