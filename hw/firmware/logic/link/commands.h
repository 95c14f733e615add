/* Requests of the host → what is done → the reply. Every request may be repeated without doing its work twice. */
#ifndef COMMANDS_H
#define COMMANDS_H

#include "controller.h"
#include "framing.h"

struct reply { uint8_t type, size; uint8_t payload[PAYLOAD_LONGEST]; };

void answer(struct controller *c, const struct receiver *message, ticks_t now, struct reply *reply);

#endif
