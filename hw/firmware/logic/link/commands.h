/* Requests of the host: executes one and makes its reply. Every request may be repeated without being executed twice. */
#ifndef COMMANDS_H
#define COMMANDS_H

#include "controller.h"
#include "framing.h"

struct reply { uint8_t type, size; uint8_t payload[PAYLOAD_LONGEST]; };

void handle_request(struct controller *c, const struct receiver *message, ticks_t now, struct reply *reply);

#endif
