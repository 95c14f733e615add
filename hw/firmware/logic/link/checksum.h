/* CRC-16/CCITT-FALSE of frames and CRC-32 (as in zlib) of configurations. */
#ifndef CHECKSUM_H
#define CHECKSUM_H

#include <stdint.h>

#define CRC16_START 0xFFFFu

uint16_t crc16_step(uint16_t crc, uint8_t byte);
uint16_t crc16(const uint8_t *bytes, uint8_t count);

/* `crc` is 0 for the first part, then the result of the part before. */
uint32_t crc32_of(uint32_t crc, const void *bytes, uint8_t count);

#endif
