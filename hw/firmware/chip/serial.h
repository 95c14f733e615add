/* The serial port: two ring buffers between interrupts and the main loop, which never waits for them. */
#ifndef SERIAL_H
#define SERIAL_H

#include <stdint.h>

void serial_start(void);
int16_t serial_take(void); /* the next byte, or -1 */
uint8_t serial_waits(void); /* whether there is a next byte */
uint8_t serial_room(void); /* free bytes of the transmit buffer */
void serial_send(const uint8_t *bytes, uint8_t count);
uint8_t serial_take_lost(void); /* returns and resets the count of bytes lost by buffer or UART */

#endif
