#include "checksum.h"

/* The arithmetic of avr-libc's _crc_xmodem_update in portable C. A table would cost 512 bytes of flash.
 * Not _crc_ccitt_update: that is another CRC (0x6F91 instead of 0x29B1 for "123456789"). */
uint16_t crc16_step(uint16_t crc, uint8_t byte)
{
    uint8_t x = (uint8_t)(crc >> 8) ^ byte;
    x ^= x >> 4;
    return (uint16_t)((crc << 8) ^ ((uint16_t)x << 12) ^ ((uint16_t)x << 5) ^ x);
}

uint16_t crc16(const uint8_t *bytes, uint8_t count)
{
    uint16_t crc = CRC16_START;
    while (count--) crc = crc16_step(crc, *bytes++);
    return crc;
}

/* Bit by bit, which is slow: it runs once per configuration, never while armed. */
uint32_t crc32_of(uint32_t crc, const void *bytes, uint8_t count)
{
    const uint8_t *byte = bytes;
    crc = ~crc;
    while (count--) {
        crc ^= *byte++;
        for (uint8_t bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320UL : 0);
    }
    return ~crc;
}
