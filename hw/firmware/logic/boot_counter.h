/* The boot counter has two copies in the EEPROM, written alternately, because power may fail during a write. */
#ifndef BOOT_COUNTER_H
#define BOOT_COUNTER_H

#include <stdint.h>

struct boot_slot { uint32_t count, inverted; };

/* Returns the slot to write, 0 or 1, and fills `next` with its new content. */
uint8_t boot_next(const struct boot_slot slots[2], struct boot_slot *next);

#endif
