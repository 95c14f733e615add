// The mean grey of every frame of a bay of the ring, read in place: mcs Ring.cs && mono Ring.exe FILE BAY
using System;
using System.IO;
using System.IO.MemoryMappedFiles;
using System.Threading;

public sealed class Ring : IDisposable
{
    readonly MemoryMappedFile file;
    readonly MemoryMappedViewAccessor view;
    public readonly uint Bays, Cameras, SlotsPerCamera;
    readonly long slotBytes, cameraTable, bayTable, slotTable, firstSlot;

    public Ring(string path)
    {
        // The station writes meanwhile.
        var stream = new FileStream(path, FileMode.Open, FileAccess.Read, FileShare.ReadWrite);
        file = MemoryMappedFile.CreateFromFile(
            stream, null, 0, MemoryMappedFileAccess.Read, HandleInheritability.None, false);
        view = file.CreateViewAccessor(0, 0, MemoryMappedFileAccess.Read);
        if (view.ReadUInt64(0) != 0x474E4952494F4156 || view.ReadUInt32(8) != 1 || view.ReadUInt32(36) != 1)
            throw new InvalidDataException("not a ring of layout version 1 that is in use");  // "VAOIRING"
        Bays = view.ReadUInt32(48);
        Cameras = view.ReadUInt32(52);
        SlotsPerCamera = view.ReadUInt32(56);
        slotBytes = view.ReadInt64(64);
        cameraTable = view.ReadInt64(72);
        bayTable = view.ReadInt64(80);
        slotTable = view.ReadInt64(88);
        firstSlot = view.ReadInt64(96);
    }

    public long SlotsPerBay { get { return (long)Cameras * SlotsPerCamera; } }
    public long Generation(long bay) { return view.ReadInt64(bayTable + bay * 16); }
    public long Camera(long slot) { return slot / SlotsPerCamera % Cameras; }
    public uint BytesPerPixel(long camera) { return view.ReadUInt32(cameraTable + camera * 16 + 12); }
    public uint State(long slot) { return view.ReadUInt32(slotTable + slot * 32 + 8); }
    public uint Row(long slot) { return view.ReadUInt32(slotTable + slot * 32 + 12); }

    // Copies the pixels of a slot, if they still are those of the run that has this generation.
    public byte[] Frame(long slot, long generation)
    {
        long bay = slot / SlotsPerBay, camera = cameraTable + Camera(slot) * 16;
        var pixels = new byte[view.ReadInt32(camera) * view.ReadInt32(camera + 4) * view.ReadInt32(camera + 12)];
        bool same = Generation(bay) == generation;
        Thread.MemoryBarrier();
        view.ReadArray(firstSlot + slot * slotBytes, pixels, 0, pixels.Length);
        Thread.MemoryBarrier();
        if (!same || Generation(bay) != generation)
            throw new InvalidOperationException("the bay went to another board meanwhile");
        return pixels;
    }

    public void Dispose()
    {
        view.Dispose();
        file.Dispose();
    }

    static void Main(string[] arguments)
    {
        using (var ring = new Ring(arguments[0]))
        {
            long bay = long.Parse(arguments[1]);
            if (bay < 0 || bay >= ring.Bays) throw new ArgumentException("no such bay");
            long generation = ring.Generation(bay);
            for (long slot = bay * ring.SlotsPerBay; slot < (bay + 1) * ring.SlotsPerBay; slot++)
            {
                if (ring.State(slot) == 0) continue;
                byte[] pixels = ring.Frame(slot, generation);
                uint size = ring.BytesPerPixel(ring.Camera(slot));
                double sum = 0;
                for (int k = 0; k < pixels.Length; k += (int)size)
                    sum += size == 1 ? pixels[k] : BitConverter.ToUInt16(pixels, k);
                Console.WriteLine("camera {0} row {1} {2} {3:F3}", ring.Camera(slot), ring.Row(slot),
                    ring.State(slot) == 1 ? "ok" : "incomplete", sum / (pixels.Length / size));
            }
        }
    }
}
