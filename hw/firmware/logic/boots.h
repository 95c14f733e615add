/* The boot counter lives in two places of the EEPROM, written in turn: power may fail while one is written. */
#ifndef BOOTS_H
#define BOOTS_H

#include <stdint.h>

struct boot_slot { uint32_t count, inverted; };

/* Which slot to write, 0 or 1, and what it must hold from now on. */
uint8_t boot_next(const struct boot_slot slots[2], struct boot_slot *next);

#endif
