#include "boot_counter.h"

/* A slot whose write was interrupted does not match its inverted copy and counts as 0. */
static uint32_t count_of(const struct boot_slot *slot) { return slot->count == ~slot->inverted ? slot->count : 0; }

uint8_t boot_next(const struct boot_slot slots[2], struct boot_slot *next)
{
    uint32_t first = count_of(&slots[0]), second = count_of(&slots[1]);
    next->count = (first > second ? first : second) + 1;
    next->inverted = ~next->count;
    return first > second; /* the older slot: the newer one stays valid during the write */
}
