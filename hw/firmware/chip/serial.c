#include "serial.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"

#define RX_SIZE 128 /* powers of two; with 8-bit indices one place stays free */
#define TX_SIZE 256

static uint8_t rx[RX_SIZE], tx[TX_SIZE];
static volatile uint8_t rx_in, rx_out, rx_lost, tx_in, tx_out;

ISR(USART_RX_vect)
{
    /* The error flags must be read before the data register, which clears them (ATmega328P data sheet, USART). */
    uint8_t overrun = UCSR0A & ((1 << DOR0) | (1 << FE0));
    uint8_t byte = UDR0, next = (rx_in + 1) % RX_SIZE;
    if (overrun) rx_lost++; /* the frame's checksum detects it */
    if (next == rx_out) {
        rx_lost++;
        return;
    }
    rx[rx_in] = byte;
    rx_in = next;
}

ISR(USART_UDRE_vect)
{
    if (tx_in == tx_out) {
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
        return;
    }
    UDR0 = tx[tx_out++];
}

void serial_start(void)
{
    PORTD |= SERIAL_RX; /* pull-up: an open line stays idle */
    UBRR0 = BAUD_DIVIDER;
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
    UCSR0B = (1 << RXCIE0) | (1 << RXEN0) | (1 << TXEN0);
}

uint8_t serial_waits(void) { return rx_in != rx_out; }

int16_t serial_take(void)
{
    if (!serial_waits()) return -1;
    uint8_t byte = rx[rx_out];
    rx_out = (rx_out + 1) % RX_SIZE;
    return byte;
}

uint8_t serial_room(void) { return (uint8_t)(tx_out - tx_in - 1); }

void serial_send(const uint8_t *bytes, uint8_t count)
{
    while (count--) tx[tx_in++] = *bytes++;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) UCSR0B |= 1 << UDRIE0;
}

uint8_t serial_take_lost(void)
{
    uint8_t lost;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        lost = rx_lost;
        rx_lost = 0;
    }
    return lost;
}
