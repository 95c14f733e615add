/* The version of this firmware; that of the protocol is in protocol.h. */
#ifndef VERSION_H
#define VERSION_H

#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 4
#define FIRMWARE_PATCH 0

#ifndef FIRMWARE_BUILD
#define FIRMWARE_BUILD "" /* set by `make` to the commit */
#endif

#endif
