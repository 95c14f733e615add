/* The contacts of IPC-SMEMA-9851 beside "line ready": board available and failed board available of the machine upstream
 * and to the next one, and machine ready of the next one. An offer lasts until the next machine has taken its board, also
 * while the host is late or gone; without the host the outputs are open. */
#ifndef CONTACTS_H
#define CONTACTS_H

#include "config.h"

struct controller;

#define CONTACT_INPUTS 3

struct contacts {
    uint8_t used;                     /* the host has sent an OFFER since the reset: changes are reported */
    uint8_t levels;                   /* enum contact; 1: closed. Inputs are debounced */
    uint8_t reported;
    ticks_t agreed[CONTACT_INPUTS];   /* when each input last had its debounced level */
    struct offer_request offer;
    ticks_t since;                    /* when the offer came */
    uint32_t lasting;                 /* ticks for which it is valid from then on; 0: there is none */
    uint16_t taken;                   /* number of the board that the next machine has taken last */
    uint8_t moving;                   /* the board has been offered to a machine that is ready, since `met` */
    ticks_t met;
    uint8_t paused;                   /* an output opened less than READY_PAUSE ago, at `opened` */
    ticks_t opened;
};

/* Takes an offer of the host; returns NAK_NONE or the refusal. */
struct refusal contacts_offer(struct controller *c, const struct offer_request *request, ticks_t now);
/* Debounces the inputs, sets the outputs and reports changes. To be called as often as possible. */
void contacts_poll(struct controller *c, ticks_t now);

#endif
