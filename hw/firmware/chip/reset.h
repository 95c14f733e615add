/* Why the chip was reset, how often, and the watchdog. */
#ifndef RESET_H
#define RESET_H

#include <stdint.h>

uint8_t reset_cause(void);
uint32_t reset_count(void); /* counts this one: call it once */
uint32_t unit_number(void);
void watchdog_start(void);

#endif
