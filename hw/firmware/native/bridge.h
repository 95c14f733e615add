#ifndef BRIDGE_H
#define BRIDGE_H

#include "commands.h"
#include "simulated_chip.h"

void bridge_start(ticks_t now);
void bridge_boot(ticks_t now, uint32_t boots);
void bridge_edge(ticks_t tick, uint8_t blocked);
void bridge_encoder(int32_t position);
void bridge_poll(ticks_t now);
uint32_t bridge_talk(const uint8_t *bytes, uint32_t count, uint8_t *frames, ticks_t now);
uint16_t bridge_bad_frames(void);
uint8_t bridge_event(struct event *event);
const char *bridge_violation(ticks_t now);

#endif
