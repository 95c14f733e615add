/* The output "line ready", with which a conveyor lets the next board in: high only while the host has permitted one more
 * board and this controller would film it. Everything unknown is low. */
#ifndef INTERLOCK_H
#define INTERLOCK_H

#include "config.h"

struct controller;

struct interlock {
    uint16_t permit;   /* of the host's last statement */
    uint16_t spent;    /* permit that a board has used; PERMIT_TEST: none */
    ticks_t since;     /* when the statement came */
    uint32_t lasting;  /* ticks for which it is valid from then on; 0: there is none */
    ticks_t fell;      /* when the output fell last */
    uint8_t opened;    /* it fell less than READY_PAUSE ago */
    uint8_t high;      /* level of the output */
    uint8_t hold;      /* enum hold */
};

/* Takes a statement of the host; returns NAK_NONE or the refusal. */
struct refusal interlock_state(struct controller *c, const struct ready_request *request, ticks_t now);
/* A board has come: the present permit is used up. */
void interlock_spend(struct controller *c);
/* Lowers the output, which then stays low for READY_PAUSE. */
void interlock_drop(struct controller *c, ticks_t now);
/* Sets the output. To be called as often as possible. */
void interlock_poll(struct controller *c, ticks_t now);

#endif
