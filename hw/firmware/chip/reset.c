#include "reset.h"

#include <avr/eeprom.h>
#include <avr/wdt.h>

#include "board.h"
#include "boot_counter.h"

static struct boot_slot EEMEM boot_slots[2];
static uint32_t EEMEM unit = 0xFFFFFFFF;

static uint8_t cause __attribute__((section(".noinit"))); /* written in .init3, before .bss is cleared */

/* After a watchdog reset the watchdog stays on with 16 ms (avr-libc, wdt.h): it must be stopped before anything takes so
 * much time. */
void stop_watchdog(void) __attribute__((naked, used, section(".init3")));
void stop_watchdog(void)
{
    cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

uint8_t reset_cause(void) { return cause; }

uint32_t reset_count(void)
{
    struct boot_slot slots[2], next;
    eeprom_read_block(slots, boot_slots, sizeof slots);
    uint8_t which = boot_next(slots, &next);
    eeprom_update_block(&next, &boot_slots[which], sizeof next);
    return next.count;
}

uint32_t unit_number(void) { return eeprom_read_dword(&unit); }

void watchdog_start(void) { wdt_enable(WDTO_250MS); }
