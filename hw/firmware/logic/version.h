/* Of this firmware; the protocol has its own in protocol.h. */
#ifndef VERSION_H
#define VERSION_H

#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 0
#define FIRMWARE_PATCH 0

#ifndef FIRMWARE_BUILD
#define FIRMWARE_BUILD "" /* `make` gives the commit */
#endif

#endif
