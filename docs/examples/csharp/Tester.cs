// Waits for boards, and reads the pictures of each: Tester BOARD_TYPE COMPONENT [BOARDS]
using System;
using System.IO;
using System.Linq;
using System.Net.Http;
using System.Threading.Tasks;
using Vaoi;

static class Tester
{
    static async Task Work(string boardType, string component, int boards)
    {
        string address = Environment.GetEnvironmentVariable("VAOI_STATION") ?? "http://127.0.0.1:8350";
        string key = Environment.GetEnvironmentVariable("VAOI_KEY"); // only from other machines than the station's
        using (var station = new VaoiStation(address, key, Environment.GetEnvironmentVariable("VAOI_CA")))
        {
            Run latest = await station.LatestRun();
            string after = latest == null ? null : latest.Id; // so that no board is missed from here on
            await station.Arm(boardType, jobId: "guide");
            while (boards > 0)
            {
                Run run = await station.NextRun(after);
                if (run == null) continue; // none in 30 s: ask again
                after = run.Id;
                boards--;
                Console.WriteLine("run " + run.Id + ": " + run.Verdict);
                if (run.Verdict != "failed")
                {
                    await station.Hold(run.Id, "Tester.cs");
                    try { await Read(station, run.Id, component); }
                    finally { await station.Release(run.Id, "Tester.cs"); }
                }
            }
            await station.Disarm();
        }
    }

    static async Task Read(VaoiStation station, string run, string component)
    {
        Matrices matrices = await station.Matrices(run);
        Console.WriteLine("  C: scale " + matrices.CadOf(component)[0].Take(2).Select(v => v * v).Sum().ToString("0.00"));
        foreach (View view in (await station.Component(run, component, "limit", 2)).Views)
        {
            Picture picture = await station.Picture(view);
            Console.WriteLine("  camera {0} row {1}: {2} x {3}, grey level {4} in the middle", view.Camera, view.Row,
                picture.Width, picture.Height, picture[picture.Width / 2, picture.Height / 2]);
            File.WriteAllBytes(view.K + ".png", await station.PictureFile(view));
        }
        int components = 0, pictures = 0;
        await station.Pictures(run, null, found => { components++; pictures += found.Pictures.Count; }, "limit", 1);
        Console.WriteLine("  best pictures: {0} of {1} components", pictures, components);
    }

    static int Main(string[] arguments)
    {
        try
        {
            int boards = arguments.Length > 2 ? int.Parse(arguments[2]) : 1;
            Work(arguments[0], arguments[1], boards).GetAwaiter().GetResult();
            return 0;
        }
        catch (StationException refused)
        {
            Console.Error.WriteLine(refused.Code + ": " + refused.Message + " " + refused.Action);
            return 1;
        }
        catch (HttpRequestException absent)
        {
            Console.Error.WriteLine("The station does not reply: " + absent.GetBaseException().Message);
            return 1;
        }
    }
}
