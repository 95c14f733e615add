/* The serial line: two rings between interrupts and the main loop, which never waits for it. */
#ifndef SERIAL_H
#define SERIAL_H

#include <stdint.h>

void serial_start(void);
int16_t serial_take(void); /* the next byte, or -1 */
uint8_t serial_waits(void); /* whether there is a next byte */
uint8_t serial_room(void); /* bytes that can be sent now */
void serial_send(const uint8_t *bytes, uint8_t count);
uint8_t serial_take_lost(void); /* bytes lost since last asked, by us or by the UART */

#endif
