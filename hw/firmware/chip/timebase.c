#include "timebase.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"

static volatile uint16_t overflows;

ISR(TIMER1_OVF_vect) { overflows++; }

void timebase_start(void)
{
    TCCR1B = (1 << ICNC1) | (1 << ICES1) | (1 << CS11); /* noise canceller on; rising edge first; clk/8 */
    TIMSK1 |= 1 << TOIE1;
}

ticks_t timebase_extend(uint16_t count)
{
    uint16_t high = overflows;
    /* An overflow whose interrupt is still pending happened before a small count and after a large one. */
    if (TIFR1 & (1 << TOV1) && count < 0x8000) high++;
    return (ticks_t)high << 16 | count;
}

ticks_t timebase_now(void)
{
    ticks_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = timebase_extend(TCNT1);
    return now;
}
